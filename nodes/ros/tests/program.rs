//! Nodes on the trait [`NodeProgram`], over DDS on loopback, and as processes of their own.

use crate::fresh_domain::fresh_domain;
use crate::participants::{PATIENCE, contexts, node};
use rustix::process::{Pid, Signal, kill_process};
use std::{
    collections::BTreeSet,
    io::{BufRead as _, BufReader},
    process::{Command, ExitCode, Stdio},
    sync::Arc,
    time::Duration,
};
use wm_msgs::std_srvs::{Outcome, SetBool, SetBoolRequest, Trigger, TriggerRequest};
use wm_ros::{
    Error, GraphEndpoint, Node, NodeArgs, NodeDefinition, NodeProgram, Requests, Service, Setup,
    answer,
};

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Whether it has the service `~/step`.
        has_step: bool = false;
        /// The exit code; negative: contradictory.
        code: i64 = 3;
    }
}

wm_ros::endpoints! {
    /// Requests of clients.
    enum Request {
        /// Switches it on or off.
        Switch(Service<SetBool>) = "~/switch";
        /// Counts, with has_step.
        Step(Option<Service<Trigger>>) = "~/step", if(|node| node.parameter("has_step"));
    }
}

#[derive(Default)]
struct Counter {
    count: u8,
    is_on: bool,
}

fn contradictory() -> Error {
    Error::ShutDown("the parameter code is negative".to_owned())
}

impl NodeProgram for Counter {
    const NAME: &'static str = "counter";
    const ABOUT: &'static str = "Counts.";
    type Parameters = Parameters;
    type Endpoints = Requests<Request>;
    type Resources = ();
    type Error = Error;

    async fn load(_: &Node, _: &Arc<Parameters>) -> Result<(), Error> {
        Ok(())
    }

    fn activate(_: &Setup<Self>) -> Result<Self, Error> {
        Ok(Self::default())
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<(), Error> {
        while let Some(request) = at.endpoints.next_request().await {
            let success = true;
            match request {
                Request::Switch(call) => {
                    self.is_on = call.request.data;
                    let message = String::new();
                    answer(call, &Outcome { success, message });
                }
                Request::Step(call) => {
                    self.count += u8::from(self.is_on);
                    let message = self.count.to_string();
                    answer(call, &Outcome { success, message });
                }
            }
        }
        Ok(())
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_node_answers_all_its_services_until_the_shutdown() {
    let [here, there] = contexts();
    let counter = node(&here, "counter", "--ros-args -p has_step:=true");
    let client = node(&there, "client", "");
    let switch = client.client::<SetBool>("counter/switch").unwrap();
    let step = client.client::<Trigger>("counter/step").unwrap();
    let calls = async {
        switch.wait_for_service().await;
        step.wait_for_service().await;
        let mut counts = Vec::new();
        for data in [false, true, true] {
            switch.call(&SetBoolRequest { data }).await.unwrap();
            let outcome = step.call(&TriggerRequest::default()).await.unwrap();
            counts.push(outcome.message);
        }
        here.shutdown().trigger();
        counts
    };
    let body = NodeDefinition::of::<Counter>().body;
    let both = async { tokio::join!(body(counter), calls) };
    let (ended, counts) = tokio::time::timeout(PATIENCE, both).await.unwrap();
    ended.unwrap();
    assert_eq!(counts, ["0", "1", "2"]);
}

#[tokio::test(flavor = "current_thread")]
async fn a_service_that_is_not_made_is_documented_but_absent() {
    let [here, there] = contexts();
    let counter = node(&here, "counter", "");
    let client = node(&there, "client", "");
    let switch = client.client::<SetBool>("counter/switch").unwrap();
    let definition = NodeDefinition::of::<Counter>();
    assert!(definition.help().contains("~/step  std_srvs/srv/Trigger"));
    let calls = async {
        switch.wait_for_service().await;
        let data = true;
        switch.call(&SetBoolRequest { data }).await.unwrap();
        let endpoints = client.remote_endpoints();
        here.shutdown().trigger();
        endpoints
    };
    let both = async { tokio::join!((definition.body)(counter), calls) };
    let (ended, endpoints) = tokio::time::timeout(PATIENCE, both).await.unwrap();
    ended.unwrap();
    let has = |name: &str| endpoints.iter().any(|endpoint| endpoint.name == name);
    assert!(
        has("/wm/counter/switch") && !has("/wm/counter/step"),
        "{endpoints:?}"
    );

    // access control is made from the declarations: an undeclared endpoint would be denied
    let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
    let declared = definition.in_graph(&args, "/wm").unwrap().endpoints;
    let found = endpoints.into_iter().map(|endpoint| GraphEndpoint {
        role: endpoint.role,
        name: endpoint.name,
    });
    let found: BTreeSet<_> = found.collect();
    let undeclared: Vec<_> = found.difference(&declared).collect();
    assert!(undeclared.is_empty(), "{undeclared:?}");
    let absent: BTreeSet<_> = declared.difference(&found).map(|e| &*e.name).collect();
    let expected = ["/clock", "/parameter_events", "/wm/counter/step"];
    assert_eq!(absent, BTreeSet::from(expected));
}

/// Works once, fails, and leaves its exit code in `finish`.
struct Lone(u8);

impl NodeProgram for Lone {
    const NAME: &'static str = "lone";
    const ABOUT: &'static str = "Ends by itself.";
    const RUNS_ALONE: bool = true;
    type Parameters = Parameters;
    type Endpoints = ();
    type Resources = u8;
    type Error = Error;

    fn check(parameters: &Parameters) -> Result<(), Error> {
        match parameters.code < 0 {
            true => Err(contradictory()),
            false => Ok(()),
        }
    }

    async fn load(_: &Node, parameters: &Arc<Parameters>) -> Result<u8, Error> {
        Ok(u8::try_from(parameters.code).unwrap_or(u8::MAX))
    }

    fn activate(at: &Setup<Self>) -> Result<Self, Error> {
        Ok(Self(at.resources))
    }

    async fn run(&mut self, _: &mut Setup<Self>) -> Result<(), Error> {
        Err(Error::ShutDown("the work".to_owned()))
    }

    fn finish(self, ended: Result<(), Error>) -> Result<ExitCode, Error> {
        assert_eq!(ended.unwrap_err().to_string(), shut_down().to_string());
        Ok(ExitCode::from(self.0))
    }
}

fn shut_down() -> Error {
    Error::ShutDown("the work".to_owned())
}

#[test]
#[ignore = "started by the tests of this file"]
fn child() {
    let code = std::env::var("CODE").unwrap_or_default();
    let args = ["--ros-args", "-p", &format!("code:={code}")].map(str::to_owned);
    let args = NodeArgs::parse(args).unwrap();
    let definition = NodeDefinition::of::<Lone>();
    assert!(definition.component().is_none());
    let code = match (definition.run)(&args) {
        Ok(code) if code == ExitCode::from(7) => 7,
        Ok(_) => 1,
        Err(error) if error.to_string() == contradictory().to_string() => 2,
        Err(_) => 3,
    };
    std::process::exit(code);
}

/// The exit code of the node [`Lone`] with this parameter.
fn lone(code: &str) -> Option<i32> {
    let domain = fresh_domain();
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "program::child"])
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("CODE", code)
        .status();
    child.unwrap().code()
}

#[test]
fn a_lone_node_finishes_after_a_failure() {
    assert_eq!(lone("7"), Some(7));
}

#[test]
fn contradictory_parameters_end_a_node_at_once() {
    assert_eq!(lone("-1"), Some(2));
}

#[test]
#[ignore = "started by the tests of this file"]
fn blocking_child() {
    let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
    let body = async |_| {
        println!("the body runs");
        std::thread::sleep(Duration::from_secs(60));
        Ok::<(), wm_ros::Error>(())
    };
    wm_ros::run("blocking", "/", &args, body).unwrap();
}

#[test]
fn body_that_blocks_is_ended_by_force() {
    let domain = fresh_domain();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--ignored",
            "--exact",
            "--nocapture",
            "program::blocking_child",
        ])
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("the body runs")));
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1));
}
