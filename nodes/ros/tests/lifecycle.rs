//! A managed node over DDS on loopback, told what to do by another participant.

use crate::participants::{PATIENCE, contexts, node, readers_of_both};
use std::cell::{Cell, RefCell};
use wm_msgs::{
    lifecycle_msgs::{
        ChangeState, ChangeStateRequest, EmptyRequest, GetState, Transition, TransitionEvent,
    },
    std_msgs::String as Text,
    wm_msgs::{Reset, ResetRequest, ResetResponse},
};
use wm_ros::{
    Client, Error, Lifecycle, Managed, Node, Publisher, Qos, Received, Service, Subscription,
    answer,
};

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

    async fn configure(&self, _: &Node) -> Result<Held<'a>, Error> {
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

    async fn run(&self, _: &mut Held<'a>, _: &mut Held<'a>) -> Result<(), Error> {
        self.note("running");
        std::future::pending().await
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_managed_node_does_what_it_is_told() {
    let [here, there] = contexts();
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
        // what is published before the publisher knows of the subscription is lost, as any volatile topic's
        let mut changes = managed.graph_changes();
        while managed
            .count_subscribers("managed/transition_event")
            .unwrap()
            == 0
        {
            changes.changed().await.unwrap();
        }
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
async fn failed_autostart_ends_the_node_with_its_error() {
    let [here] = contexts();
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

/// Repeats what it hears, and serves a reset that it answers only when it is asked to.
struct Echo;

struct EchoEndpoints {
    heard: Subscription<Text>,
    latched: Subscription<Text>,
    said: Publisher<Text>,
    resets: Service<Reset>,
}

impl Managed for Echo {
    type Configured = EchoEndpoints;
    type Active = ();
    type Error = Error;

    async fn configure(&self, node: &Node) -> Result<EchoEndpoints, Error> {
        let qos = Qos::reliable(10);
        let said = node.publisher("said", qos)?;
        // rclcpp's publishers of managed nodes drop it as silently
        said.publish(&text("of an inactive node"))?;
        Ok(EchoEndpoints {
            heard: node.subscription("heard", qos)?,
            latched: node.subscription_catching_up("latched", qos)?,
            said,
            resets: node.service_or_refuse("~/reset", |reason| ResetResponse {
                success: false,
                message: reason.to_owned(),
            })?,
        })
    }

    fn activate(&self, _: &EchoEndpoints) -> Result<(), Error> {
        Ok(())
    }

    async fn run(&self, endpoints: &mut EchoEndpoints, (): &mut ()) -> Result<(), Error> {
        let mut held = Vec::new();
        loop {
            tokio::select! {
                Some(Received { message, .. }) = endpoints.heard.recv() => endpoints.said.publish(&message)?,
                Some(Received { message, .. }) = endpoints.latched.recv() => {
                    endpoints.said.publish(&text(&format!("latched {}", message.data)))?;
                }
                Some(call) = endpoints.resets.recv() => {
                    if call.request.seed == 0 {
                        held.push(call);
                        endpoints.said.publish(&text("held"))?;
                    } else {
                        answer(call, &ResetResponse { success: true, message: String::new() });
                    }
                }
            }
        }
    }
}

fn text(data: &str) -> Text {
    Text {
        data: data.to_owned(),
    }
}

async fn change(client: &Client<ChangeState>, label: &str) {
    let transition = Transition {
        id: 0,
        label: label.to_owned(),
    };
    let answer = client.call(&ChangeStateRequest { transition }).await;
    assert!(answer.unwrap().success, "{label}");
}

async fn next(subscription: &mut Subscription<Text>) -> String {
    let received = tokio::time::timeout(PATIENCE, subscription.recv()).await;
    received.unwrap().unwrap().message.data
}

#[tokio::test(flavor = "current_thread")]
async fn endpoints_of_an_inactive_node_exist_and_are_silent() {
    let [here, there] = contexts();
    let echo = node(&here, "echo", "--ros-args -p autostart:=false");
    let lifecycle = Lifecycle::new(&echo).unwrap();
    let manager = node(&there, "manager", "");
    let qos = Qos::reliable(10);
    let to_echo = manager.publisher::<Text>("heard", qos).unwrap();
    let latching = manager
        .publisher::<Text>("latched", Qos::latched(1))
        .unwrap();
    let mut said = manager.subscription::<Text>("said", qos).unwrap();
    let changes = manager.client::<ChangeState>("echo/change_state").unwrap();
    let resets = manager.client::<Reset>("echo/reset").unwrap();
    let reset = |seed| ResetRequest {
        seed,
        keep_seed: false,
    };
    let told = async {
        latching.publish(&text("goal")).unwrap();
        changes.wait_for_service().await;
        change(&changes, "configure").await;
        said.wait_for_publishers(1).await;
        to_echo.wait_for_subscribers(1).await;
        latching.wait_for_subscribers(readers_of_both()).await;
        resets.wait_for_service().await;

        let refusal = resets.call(&reset(7)).await.unwrap();
        assert!(
            !refusal.success
                && refusal
                    .message
                    .contains("/wm/echo/reset: the node is not active"),
            "{refusal:?}"
        );
        to_echo.publish(&text("too early")).unwrap();
        assert!(to_echo.wait_for_acknowledgments(PATIENCE).await.unwrap());
        for round in 0..3 {
            change(&changes, "activate").await;
            // the first that is heard: neither what came before nor what was said before
            assert_eq!(next(&mut said).await, "latched goal", "round {round}");
            to_echo.publish(&text("now")).unwrap();
            assert_eq!(next(&mut said).await, "now");
            assert!(resets.call(&reset(7)).await.unwrap().success);
            // a call that is under way when the node is deactivated is refused, too
            let left = reset(0);
            let under_way = resets.call(&left);
            let deactivated = async {
                assert_eq!(next(&mut said).await, "held");
                change(&changes, "deactivate").await;
            };
            let (refusal, ()) = tokio::join!(under_way, deactivated);
            assert!(!refusal.unwrap().success);
            to_echo.publish(&text("inactive")).unwrap();
            assert!(to_echo.wait_for_acknowledgments(PATIENCE).await.unwrap());
            assert_eq!(
                (
                    manager.count_publishers("said").unwrap(),
                    to_echo.subscribers()
                ),
                (1, 1)
            );
        }
        change(&changes, "shutdown").await;
    };
    let both = async { tokio::join!(lifecycle.run(Echo), told) };
    let (ended, ()) = tokio::time::timeout(PATIENCE * 3, both).await.unwrap();
    ended.unwrap();
    // nothing of what an inactive node does not hear is a loss
    assert!(said.try_recv().is_none());
}
