//! A managed node over DDS on loopback, told what to do by another participant.

#![allow(clippy::unwrap_used, reason = "a test's helpers may fail the test")]

use std::{
    cell::{Cell, RefCell},
    time::Duration,
};
use wm_msgs::lifecycle_msgs::{
    ChangeState, ChangeStateRequest, EmptyRequest, GetState, Transition, TransitionEvent,
};
use wm_ros::{Context, Environment, Error, Lifecycle, Managed, Node, NodeArgs, Qos, Reach};

/// Far above anything that discovery takes; it only ends a test that hangs.
const PATIENCE: Duration = Duration::from_secs(20);

fn context(test: u16) -> Context {
    // Apart from the domains of this crate's other tests, and from another run of this one.
    let domain_id = 221 + (std::process::id() as u16 % 5) * 2 + test;
    Context::new(&Environment {
        domain_id,
        reach: Reach::Localhost,
    })
    .unwrap()
}

fn node(context: &Context, name: &str, line: &str) -> Node {
    let args = NodeArgs::parse(line.split_whitespace()).unwrap();
    Node::new(context, name, "/wm", &args).unwrap()
}

/// Writes down what it is told; its first configuration fails.
#[derive(Default)]
struct Diary {
    lines: RefCell<Vec<&'static str>>,
    has_failed: Cell<bool>,
}

impl Diary {
    fn note(&self, line: &'static str) {
        self.lines.borrow_mut().push(line);
    }
}

/// Says when it is dropped.
struct Held<'a>(&'a Diary, &'static str);

impl Drop for Held<'_> {
    fn drop(&mut self) {
        self.0.note(self.1);
    }
}

impl<'a> Managed for &'a Diary {
    type Configured = Held<'a>;
    type Active = Held<'a>;
    type Error = Error;

    async fn configure(&self) -> Result<Held<'a>, Error> {
        if !self.has_failed.replace(true) {
            return Err(Error::ShutDown("the first configuration".into()));
        }
        self.note("configured");
        Ok(Held(self, "cleaned up"))
    }

    fn activate(&self, _: &Held<'a>) -> Result<Held<'a>, Error> {
        self.note("activated");
        Ok(Held(self, "deactivated"))
    }

    async fn run(&self, _: &mut Held<'a>) -> Result<(), Error> {
        self.note("running");
        std::future::pending().await
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_managed_node_does_what_it_is_told() {
    let (here, there) = (context(0), context(0));
    let managed = node(&here, "managed", "--ros-args -p autostart:=false");
    let lifecycle = Lifecycle::new(&managed).unwrap();
    managed.seal_parameters().unwrap();
    let diary = Diary::default();

    let manager = node(&there, "manager", "");
    let change = manager
        .client::<ChangeState>("managed/change_state")
        .unwrap();
    let state = manager.client::<GetState>("managed/get_state").unwrap();
    let mut events = manager
        .subscription::<TransitionEvent>("managed/transition_event", Qos::reliable(100))
        .unwrap();
    let told = async {
        change.wait_for_service().await;
        state.wait_for_service().await;
        events.wait_for_publishers(1).await;
        for (label, success, after) in [
            ("activate", false, "unconfigured"),
            ("configure", false, "unconfigured"),
            ("configure", true, "inactive"),
            ("activate", true, "active"),
            ("cleanup", false, "active"),
            ("deactivate", true, "inactive"),
            ("activate", true, "active"),
            ("deactivate", true, "inactive"),
            ("cleanup", true, "unconfigured"),
            ("shutdown", true, "finalized"),
        ] {
            let transition = Transition {
                id: 0,
                label: label.to_owned(),
            };
            let answer = change.call(&ChangeStateRequest { transition }).await;
            assert_eq!(answer.unwrap().success, success, "{label}");
            // Still in the graph: the test holds the node's handle.
            let now = state.call(&EmptyRequest::default()).await.unwrap();
            assert_eq!(now.current_state.label, after, "{label}");
        }
    };
    let both = async { tokio::join!(lifecycle.run(&diary), told) };
    let (ended, ()) = tokio::time::timeout(PATIENCE, both).await.unwrap();
    ended.unwrap();
    assert_eq!(
        *diary.lines.borrow(),
        [
            "configured",
            "activated",
            "running",
            "deactivated",
            "activated",
            "running",
            "deactivated",
            "cleaned up"
        ]
    );
    let first = tokio::time::timeout(PATIENCE, events.recv()).await.unwrap();
    let first = first.unwrap().message;
    assert_eq!(first.start_state.label, "unconfigured");
    assert_eq!(first.goal_state.label, "configuring");
    assert!(first.timestamp > 0);
}

#[tokio::test(flavor = "current_thread")]
async fn a_node_that_starts_by_itself_ends_with_what_keeps_it_from_that() {
    let here = context(1);
    let failing = node(&here, "failing", "");
    let diary = Diary::default();
    let error = Lifecycle::new(&failing).unwrap().run(&diary).await;
    assert!(
        error
            .unwrap_err()
            .to_string()
            .contains("first configuration")
    );

    let starting = node(&here, "starting", "");
    let shutdown = starting.shutdown();
    let lifecycle = Lifecycle::new(&starting).unwrap();
    let ended = async {
        tokio::join!(lifecycle.run(&diary), async {
            while !diary.lines.borrow().contains(&"running") {
                tokio::task::yield_now().await;
            }
            shutdown.trigger();
        })
    };
    let (ended, ()) = tokio::time::timeout(PATIENCE, ended).await.unwrap();
    ended.unwrap();
    assert!(
        diary
            .lines
            .borrow()
            .ends_with(&["deactivated", "cleaned up"])
    );
}
