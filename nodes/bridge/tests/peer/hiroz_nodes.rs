//! Nodes of wm over Zenoh, and nodes of hiroz, which implements the wire format of rmw_zenoh independently.

use super::{
    harness::soon,
    hiroz_types::{self as types, Ours, SetBoolRequest, SetBoolResponse},
    zenoh_process::{hiroz_node, with_router, wm_node},
};
use hiroz::{
    Builder as _,
    entity::{EndpointKind, entity_get_endpoint},
    lifecycle::msgs::{ChangeStateRequest, LcTransition},
    parameter::{Parameter, ParameterClient, ParameterTarget, ParameterValue},
    qos::{QosDurability, QosHistory, QosProfile, QosReliability},
};
use std::{sync::Arc, time::Duration};
use wm_msgs::{
    TypeDescription,
    lifecycle_msgs::Transition,
    std_msgs::String as Text,
    std_srvs::{self, Outcome as Response},
    wm_msgs::action::{Plan, PlanFeedback, PlanGoal, PlanResult},
};
use wm_ros::{
    Descriptor, Durability, Error, GoalStatus, Lifecycle, Managed, Node, Qos, Reliability,
    RemoteEndpoint, Role,
};

const LIMIT: Duration = Duration::from_secs(20);

/// More than one batch of Zenoh, and more than one fragment of any link.
const LARGE: usize = 512 << 10;

fn text(data: &str) -> Text {
    Text {
        data: data.to_owned(),
    }
}

/// The answer to a call, made again while it fails: hiroz ends a call at once if it has not discovered the server.
async fn answered<T, F: Future<Output = zenoh::Result<T>>>(call: impl Fn() -> F) -> T {
    let answered = async {
        loop {
            match call().await {
                Ok(answer) => return answer,
                Err(_not_discovered) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    soon("an answer", answered).await
}

fn profile(qos: Qos) -> QosProfile {
    QosProfile {
        reliability: match qos.reliability {
            Reliability::Reliable => QosReliability::Reliable,
            Reliability::BestEffort => QosReliability::BestEffort,
        },
        durability: match qos.durability {
            Durability::Volatile => QosDurability::Volatile,
            Durability::TransientLocal => QosDurability::TransientLocal,
        },
        history: QosHistory::from_depth(qos.depth),
        ..QosProfile::default()
    }
}

#[test]
fn topics_reach_hiroz() {
    with_router("hiroz_nodes::topics_reach_hiroz", async |_| {
        let (_context, node) = wm_node("talker", &[]);
        let listener = hiroz_node("listener");
        for (topic, qos) in [
            ("/reliable", Qos::reliable(5)),
            ("/best_effort", Qos::best_effort(5)),
        ] {
            let publisher = node.publisher::<Text>(topic, qos).unwrap();
            let subscription = listener.create_sub::<types::Text>(topic);
            let subscription = subscription.with_qos(profile(qos)).build().unwrap();
            soon(topic, publisher.wait_for_subscribers(1)).await;
            assert!(subscription.wait_for_publisher(1, LIMIT).await, "{topic}");
            for data in ["one", &"x".repeat(LARGE)] {
                publisher.publish(&text(data)).unwrap();
                let received = soon(topic, subscription.async_recv()).await.unwrap();
                assert_eq!(received.data, data, "{topic}");
            }
        }
    });
}

#[test]
fn topics_of_hiroz_reach_wm() {
    with_router("hiroz_nodes::topics_of_hiroz_reach_wm", async |_| {
        let (_context, node) = wm_node("listener", &[]);
        let talker = hiroz_node("talker");
        for (topic, qos) in [
            ("/reliable", Qos::reliable(5)),
            ("/best_effort", Qos::best_effort(5)),
        ] {
            let mut subscription = node.subscription::<Text>(topic, qos).unwrap();
            let publisher = talker.create_pub::<types::Text>(topic);
            let publisher = publisher.with_qos(profile(qos)).build().unwrap();
            soon(topic, subscription.wait_for_publishers(1)).await;
            assert!(publisher.wait_for_subscription(1, LIMIT).await, "{topic}");
            for data in ["one", &"x".repeat(LARGE)] {
                let message = types::Text {
                    data: data.to_owned(),
                };
                publisher.async_publish(&message).await.unwrap();
                let received = soon(topic, subscription.recv()).await.unwrap();
                assert_eq!(received.message.data, data, "{topic}");
            }
            assert_eq!((subscription.lost(), subscription.undecodable()), (0, 0));
        }
    });
}

#[test]
fn late_joiners_get_latched_messages() {
    with_router(
        "hiroz_nodes::late_joiners_get_latched_messages",
        async |_| {
            let (_context, node) = wm_node("ours", &[]);
            let theirs = hiroz_node("theirs");
            let qos = Qos::latched(2);
            let ours = node.publisher::<Text>("/of_wm", qos).unwrap();
            for data in ["old", "kept", "newest"] {
                ours.publish(&text(data)).unwrap();
            }
            let late = theirs.create_sub::<types::Text>("/of_wm");
            let late = late.with_qos(profile(qos)).build().unwrap();
            for data in ["kept", "newest"] {
                let received = soon("history of wm", late.async_recv()).await.unwrap();
                assert_eq!(received.data, data);
            }

            let publisher = theirs.create_pub::<types::Text>("/of_hiroz");
            let publisher = publisher.with_qos(profile(qos)).build().unwrap();
            for data in ["old", "kept", "newest"] {
                let data = data.to_owned();
                publisher.publish(&types::Text { data }).unwrap();
            }
            let mut late = node.subscription::<Text>("/of_hiroz", qos).unwrap();
            for data in ["kept", "newest"] {
                let received = soon("history of hiroz", late.recv()).await.unwrap();
                assert_eq!(received.message.data, data);
            }
        },
    );
}

#[test]
fn services_work_in_both_directions() {
    with_router(
        "hiroz_nodes::services_work_in_both_directions",
        async |_| {
            let (_context, node) = wm_node("ours", &[]);
            let theirs = hiroz_node("theirs");

            let mut service = node.service::<std_srvs::SetBool>("/of_wm").unwrap();
            let client = theirs
                .create_client::<types::SetBool>("/of_wm")
                .build()
                .unwrap();
            let serve = async {
                for _ in 0..2 {
                    let call = service.recv().await.unwrap();
                    let message = format!("was {}", call.request.data);
                    let response = Response {
                        success: true,
                        message,
                    };
                    call.respond(&response).unwrap();
                }
            };
            let ask = async {
                for data in [true, false] {
                    let request = SetBoolRequest { data };
                    let answer = answered(|| client.call_with_timeout(&request, LIMIT)).await;
                    let SetBoolResponse { success, message } = answer;
                    assert_eq!((success, message), (true, format!("was {data}")));
                }
            };
            soon("calls of hiroz", async { tokio::join!(serve, ask) }).await;

            let mut server = theirs
                .create_service::<types::SetBool>("/of_hiroz")
                .build()
                .unwrap();
            let client = node.client::<std_srvs::SetBool>("/of_hiroz").unwrap();
            soon("server of hiroz", client.wait_for_service()).await;
            let serve = async {
                let (request, reply) = server.async_take_request().await.unwrap().into_parts();
                let response = SetBoolResponse {
                    success: request.data,
                    message: "done".to_owned(),
                };
                reply.reply(&response).await.unwrap();
            };
            let request = std_srvs::SetBoolRequest { data: true };
            let both = async { tokio::join!(serve, client.call(&request)) };
            let (_, answer) = soon("call of wm", both).await;
            let answer = answer.unwrap();
            assert_eq!((answer.success, answer.message.as_str()), (true, "done"));
        },
    );
}

#[test]
fn parameter_client_of_hiroz_reads_and_sets() {
    with_router(
        "hiroz_nodes::parameter_client_of_hiroz_reads_and_sets",
        async |_| {
            let (_context, node) = wm_node("ours", &[]);
            let gain = Descriptor::new("Gain of the test.");
            let gain = node.declare("gain", 1.5, gain).unwrap();
            node.seal_parameters().unwrap();
            let target = ParameterTarget::from_fqn("/wm/ours").unwrap();
            // the client does not keep the session open
            let theirs = hiroz_node("theirs");
            let client = ParameterClient::new(Arc::clone(&theirs), target).unwrap();

            let listed = answered(|| client.list(&[""; 0], None)).await;
            assert!(listed.names.contains(&"gain".to_owned()), "{listed:?}");
            let values = soon("get", client.get(&["gain"])).await.unwrap();
            assert_eq!(values, [ParameterValue::Double(1.5)]);
            let changes = [
                Parameter::new("gain", ParameterValue::Double(2.5)),
                Parameter::new("nothing", ParameterValue::Bool(true)),
            ];
            let results = soon("set", client.set(&changes)).await.unwrap();
            let results: Vec<bool> = results.iter().map(|result| result.successful).collect();
            assert_eq!((results, gain.get()), (vec![true, false], 2.5));
        },
    );
}

#[test]
fn both_see_the_graph() {
    with_router("hiroz_nodes::both_see_the_graph", async |_| {
        let (_context, node) = wm_node("ours", &[]);
        let theirs = hiroz_node("theirs");
        let qos = Qos::best_effort(7);
        let publisher = node.publisher::<Text>("/of_wm", qos).unwrap();
        let _service = node.service::<std_srvs::SetBool>("/service_of_wm").unwrap();
        let subscription = theirs.create_sub::<types::Text>("/of_wm");
        let subscription = subscription
            .with_qos(profile(Qos::reliable(3)))
            .build()
            .unwrap();
        let _server = theirs
            .create_service::<types::SetBool>("/service_of_hiroz")
            .build()
            .unwrap();
        soon("subscription", publisher.wait_for_subscribers(1)).await;
        assert!(subscription.wait_for_publisher(1, LIMIT).await);

        let graph = theirs.graph();
        let key = ("/wm".to_owned(), "ours".to_owned());
        assert!(graph.node_exists(key), "{:?}", graph.get_node_names());
        let of_wm = (
            "/service_of_wm".to_owned(),
            "std_srvs::srv::dds_::SetBool_".to_owned(),
        );
        // the publisher may be announced before the service
        soon("service of wm", async {
            loop {
                let changed = graph.change_notify.notified();
                if graph.get_service_names_and_types().contains(&of_wm) {
                    break;
                }
                changed.await;
            }
        })
        .await;
        let found = graph.get_entities_by_topic(EndpointKind::Publisher, "/of_wm");
        let [found] = &found[..] else {
            panic!("expected one publisher, found {found:?}")
        };
        let found = entity_get_endpoint(found).unwrap();
        assert_eq!(found.qos, profile(qos).to_protocol_qos());
        let info = found.type_info.as_ref().unwrap();
        let hash = TypeDescription::of::<Text>().unwrap().hash();
        assert_eq!(info.name, "std_msgs::msg::dds_::String_");
        assert_eq!(info.hash.to_string(), hash.to_string());

        let mut changes = node.graph_changes();
        let is_server =
            |seen: &RemoteEndpoint| seen.role == Role::Server && seen.name == "/service_of_hiroz";
        soon("server of hiroz", async {
            while !node.remote_endpoints().iter().any(is_server) {
                changes.changed().await.unwrap();
            }
        })
        .await;
        let seen = node.remote_endpoints();
        let of = |role, name: &str| {
            let mut found = seen
                .iter()
                .filter(|seen| seen.role == role && seen.name == name);
            let found = found.next();
            found.map(|found| {
                (
                    found.type_name.clone(),
                    found.qos.reliability,
                    found.qos.depth,
                )
            })
        };
        assert_eq!(
            of(Role::Subscription, "/of_wm"),
            Some(("std_msgs/msg/String".to_owned(), Reliability::Reliable, 3))
        );
        assert_eq!(
            of(Role::Server, "/service_of_hiroz").map(|(type_name, ..)| type_name),
            Some("std_srvs/srv/SetBool".to_owned())
        );
    });
}

/// Counts nothing, and works until it is deactivated.
struct Idle;

impl Managed for Idle {
    type Configured = ();
    type Active = ();
    type Error = Error;

    async fn configure(&self, _: &Node) -> Result<(), Error> {
        Ok(())
    }

    fn activate(&self, (): &()) -> Result<(), Error> {
        Ok(())
    }

    async fn run(&self, (): &mut (), (): &mut ()) -> Result<(), Error> {
        std::future::pending().await
    }
}

#[test]
fn hiroz_drives_a_managed_node() {
    with_router("hiroz_nodes::hiroz_drives_a_managed_node", async |_| {
        let arguments = ["--ros-args", "-p", "autostart:=false"];
        let (_context, node) = wm_node("managed", &arguments);
        let lifecycle = Lifecycle::new(&node).unwrap();
        node.seal_parameters().unwrap();
        let manager = hiroz_node("manager");
        let state = manager.create_client::<types::GetState>("/wm/managed/get_state");
        let state = state.build().unwrap();
        let change = manager.create_client::<types::ChangeState>("/wm/managed/change_state");
        let change = change.build().unwrap();
        let drive = async {
            use Transition as T;
            for (transition, is_possible, reached) in [
                (T::TRANSITION_CONFIGURE, true, "inactive"),
                (T::TRANSITION_ACTIVATE, true, "active"),
                (T::TRANSITION_CONFIGURE, false, "active"),
                (T::TRANSITION_DEACTIVATE, true, "inactive"),
                (T::TRANSITION_CLEANUP, true, "unconfigured"),
            ] {
                let request = ChangeStateRequest {
                    transition: LcTransition {
                        id: transition,
                        label: String::new(),
                    },
                };
                let changed = answered(|| change.call_with_timeout(&request, LIMIT)).await;
                assert_eq!(changed.success, is_possible, "{transition}");
                let empty = Ours::default();
                let asked = answered(|| state.call_with_timeout(&empty, LIMIT)).await;
                assert_eq!(asked.current_state.label, reached);
            }
        };
        tokio::select! {
            ended = lifecycle.run(Idle) => panic!("the node ended: {ended:?}"),
            () = soon("transitions", drive) => {}
        }
    });
}

#[test]
fn action_client_of_hiroz_gets_feedback_and_results() {
    with_router(
        "hiroz_nodes::action_client_of_hiroz_gets_feedback_and_results",
        async |_| {
            let (_context, node) = wm_node("planner", &[]);
            let mut server = node.action_server::<Plan>("/wm/plan").unwrap();
            let theirs = hiroz_node("theirs");
            let client = theirs
                .create_action_client::<types::Plan>("/wm/plan")
                .build()
                .unwrap();
            assert!(client.wait_for_server(LIMIT).await);
            let serve = async {
                let goal = server.recv().await.unwrap().accept().unwrap();
                let feedback = PlanFeedback {
                    candidates: 64,
                    terms: vec!["goal".to_owned()],
                    ..PlanFeedback::default()
                };
                goal.publish_feedback(&feedback).unwrap();
                let result = PlanResult {
                    message: format!("tolerance {}", goal.goal.tolerance),
                    plans: 3,
                    ..PlanResult::default()
                };
                goal.succeed(result).unwrap();

                let goal = server.recv().await.unwrap().accept().unwrap();
                goal.canceling().await;
                goal.cancel(PlanResult::default()).unwrap();

                server.recv().await.unwrap().reject();
            };
            let goal = |tolerance| {
                Ours(PlanGoal {
                    tolerance,
                    ..PlanGoal::default()
                })
            };
            let ask = async {
                let mut first = client.send_goal(goal(0.5)).await.unwrap();
                let mut feedback = first.feedback().unwrap();
                let received = feedback.recv().await.unwrap().0;
                assert_eq!(
                    (received.candidates, received.terms),
                    (64, vec!["goal".to_owned()])
                );
                let result = first.result().await.unwrap().0;
                assert_eq!(
                    (result.plans, result.message.as_str()),
                    (3, "tolerance 0.5")
                );

                let second = client.send_goal(goal(0.1)).await.unwrap();
                second.cancel().await.unwrap();
                second.result().await.unwrap();

                assert!(client.send_goal(goal(0.2)).await.is_err());
            };
            soon("goals", async { tokio::join!(serve, ask) }).await;
        },
    );
}

#[test]
fn action_client_of_wm_gets_results_of_hiroz() {
    with_router(
        "hiroz_nodes::action_client_of_wm_gets_results_of_hiroz",
        async |_| {
            let (_context, node) = wm_node("ours", &[]);
            let theirs = hiroz_node("planner");
            let server = theirs
                .create_action_server::<types::Plan>("/wm/plan")
                .build()
                .unwrap();
            let _server = server.with_handler(|goal| async move {
                let result = PlanResult {
                    plans: 2,
                    ..PlanResult::default()
                };
                goal.succeed(Ours(result)).unwrap();
            });
            let client = node.action_client::<Plan>("/wm/plan").unwrap();
            soon("server of hiroz", client.wait_for_server()).await;
            let ask = async {
                let goal = client.send(&PlanGoal::default()).await.unwrap().unwrap();
                let (status, result) = goal.result().await.unwrap();
                assert_eq!((status, result.plans), (GoalStatus::Succeeded, 2));
            };
            soon("a goal", ask).await;
        },
    );
}
