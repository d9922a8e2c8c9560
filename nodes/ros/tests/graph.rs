//! Two participants over DDS on loopback, as two processes would have them. No ROS installation is needed; the
//! other side's own client library is tested in the suite's interoperability tests.

use crate::fresh_domain::fresh_domain;
use crate::participants::{PATIENCE, context, contexts, is_over_dds, node, readers_of_both, soon};
use bytes::Bytes;
use std::time::Duration;
use wm_msgs::{
    builtin_interfaces::Time,
    cdr,
    diagnostic_msgs::DiagnosticArray,
    rosgraph_msgs,
    std_msgs::{self, Bool},
    wm_msgs::{Reset, ResetRequest, ResetResponse},
};
use wm_ros::{Context, Descriptor, Environment, Middleware, Qos, Reach, Subscription};

fn text(data: &str) -> std_msgs::String {
    std_msgs::String {
        data: data.to_owned(),
    }
}

/// The topic's other subscription keeps what was sent in between in the participant.
#[tokio::test(flavor = "current_thread")]
async fn a_subscription_that_comes_anew_gets_nothing_of_before() {
    let [here, there] = contexts();
    let (talker, listener) = (node(&here, "teller", ""), node(&there, "hearer", ""));
    let told = talker
        .publisher::<std_msgs::String>("told", Qos::reliable(10))
        .unwrap();
    let subscribe = || listener.subscription::<std_msgs::String>("told", Qos::reliable(10));
    let mut first = subscribe().unwrap();
    let mut other = subscribe().unwrap();
    soon("connecting", told.wait_for_subscribers(2)).await;
    told.publish(&text("one")).unwrap();
    soon("the first message", first.recv()).await.unwrap();
    drop(first);
    told.publish(&text("two")).unwrap();
    for _ in 0..2 {
        soon("the other's", other.recv()).await.unwrap();
    }
    let mut anew = subscribe().unwrap();
    soon("connecting again", async {
        anew.wait_for_publishers(1).await;
        told.wait_for_subscribers(2).await;
    })
    .await;
    told.publish(&text("three")).unwrap();
    let received = soon("a message", anew.recv()).await.unwrap();
    assert_eq!((received.message, anew.lost()), (text("three"), 0));
}

/// A participant keeps what was latched for the subscriptions that it had, also when these and the publisher have gone.
#[tokio::test(flavor = "current_thread")]
async fn who_comes_late_gets_what_the_living_have_latched_and_once() {
    let [here, there] = contexts();
    let (listener, talker) = (node(&here, "listener", ""), node(&there, "talker", ""));
    let latch = |data: &str| {
        let publisher = talker.publisher("map", Qos::latched(1)).unwrap();
        publisher.publish(&text(data)).unwrap();
        publisher
    };
    let subscribe = || {
        listener
            .subscription::<std_msgs::String>("map", Qos::latched(10))
            .unwrap()
    };
    let told = async |subscription: &mut Subscription<std_msgs::String>| {
        let received = soon("what is latched", subscription.recv()).await;
        received.unwrap().message
    };
    let gone = latch("gone");
    let mut early = subscribe();
    assert_eq!(told(&mut early).await, text("gone"));
    drop(early);
    let mut changes = talker.graph_changes();
    soon("the subscription's end", async {
        while gone.subscribers() > 0 {
            changes.changed().await.unwrap();
        }
    })
    .await;
    drop(gone);
    let mut changes = listener.graph_changes();
    soon("the publisher's end", async {
        while listener.count_publishers("map").unwrap() > 0 {
            changes.changed().await.unwrap();
        }
    })
    .await;

    let living = latch("living");
    let (mut one, mut late) = (subscribe(), subscribe());
    assert_eq!(told(&mut one).await, text("living"));
    assert_eq!(told(&mut late).await, text("living"));
    let mut later = subscribe();
    assert_eq!(told(&mut later).await, text("living"));
    soon("connecting", living.wait_for_subscribers(3)).await;
    living.publish(&text("last")).unwrap();
    for subscription in [&mut one, &mut late, &mut later] {
        assert_eq!(told(subscription).await, text("last"));
    }
}

#[tokio::test(flavor = "current_thread")]
async fn messages_reach_another_participant_typed_and_raw() {
    let [here, there] = contexts();
    let (talker, listener) = (
        node(&here, "talker", ""),
        node(&there, "listener", "--ros-args -r heard:=said"),
    );

    let said = talker
        .publisher::<std_msgs::String>("said", Qos::reliable(10))
        .unwrap();
    let mut heard = listener
        .subscription::<std_msgs::String>("heard", Qos::best_effort(10))
        .unwrap();
    let mut raw = listener
        .raw_subscription("/wm/said", "std_msgs/msg/String", Qos::reliable(10))
        .unwrap();
    assert_eq!(heard.topic(), "/wm/said");
    soon("connecting", async {
        said.wait_for_subscribers(2).await;
        heard.wait_for_publishers(1).await;
        raw.wait_for_publishers(1).await;
    })
    .await;
    for word in ["one", "two"] {
        said.publish(&text(word)).unwrap();
    }
    for word in ["one", "two"] {
        let received = soon("a message", heard.recv()).await.unwrap();
        assert_eq!(received.message, text(word));
        assert!(received.received <= listener.now());
        let bytes = soon("a raw message", raw.recv()).await.unwrap().message;
        assert_eq!(bytes, cdr::to_bytes(&text(word)).unwrap());
    }
    assert!(said.wait_for_acknowledgments(PATIENCE).await.unwrap());
    assert_eq!(
        (
            heard.dropped(),
            heard.lost(),
            heard.undecodable(),
            said.dropped()
        ),
        (0, 0, 0, 0)
    );

    let topics = listener.topics();
    let topic = topics
        .iter()
        .find(|topic| topic.name == "/wm/said")
        .unwrap();
    assert_eq!(
        (topic.type_name.as_str(), topic.subscribers),
        ("std_msgs/msg/String", 2)
    );
    assert_eq!(topic.publishers, [Qos::reliable(10)]);
    assert_eq!(talker.count_subscribers("said").unwrap(), 2);

    // What goes is seen to go.
    drop(heard);
    soon("the subscription's end", async {
        let mut changes = talker.graph_changes();
        while said.subscribers() > 1 {
            changes.changed().await.unwrap();
        }
    })
    .await;
    drop((said, raw, talker, listener));
    here.close();
    there.close();
}

/// More than a reliable publisher's window, which rustdds would fill with what own subscriptions do not acknowledge.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_topic_that_a_context_reads_and_publishes_goes_on() {
    const COUNT: usize = 700;
    let [here, there] = contexts();
    let both = node(&here, "both", "");
    let other = node(&there, "other", "");
    let qos = Qos::reliable(2 * COUNT);
    let mut own = both.subscription::<Bool>("two_way", qos).unwrap();
    let publisher = both.publisher::<Bool>("two_way", qos).unwrap();
    let mut remote = other.subscription::<Bool>("two_way", qos).unwrap();
    soon("connecting", publisher.wait_for_subscribers(2)).await;
    soon("connecting", remote.wait_for_publishers(1)).await;
    for _ in 0..COUNT {
        let published = publisher.publish_when_ready(&Bool { data: true });
        soon("room in the window", published).await.unwrap();
        soon("what another gets", remote.recv()).await.unwrap();
        soon("what is heard at home", own.recv()).await.unwrap();
    }
    assert!(publisher.wait_for_acknowledgments(PATIENCE).await.unwrap());
    assert!(
        own.try_recv().is_none() && remote.try_recv().is_none(),
        "twice"
    );
    assert_eq!((own.lost(), remote.lost(), publisher.dropped()), (0, 0, 0));

    // and the other way: what others publish there is heard, once
    let answer = other.publisher::<Bool>("two_way", qos).unwrap();
    soon("connecting", own.wait_for_publishers(2)).await;
    soon("connecting", answer.wait_for_subscribers(2)).await;
    answer.publish(&Bool { data: false }).unwrap();
    let received = soon("another's message", own.recv()).await.unwrap();
    assert!(!received.message.data);
    assert_eq!(both.count_publishers("two_way").unwrap(), 2);
}

/// A goal, say: one is latched before anybody asks, another comes from a publisher that does not latch.
#[tokio::test(flavor = "current_thread")]
async fn who_catches_up_hears_publishers_that_latch_and_others() {
    let [here, there] = contexts();
    let (talker, listener) = (node(&here, "setter", ""), node(&there, "seeker", ""));
    let latched = talker.publisher("goal", Qos::latched(1)).unwrap();
    latched.publish(&text("first")).unwrap();
    let mut goals = listener
        .subscription_catching_up::<std_msgs::String>("goal", Qos::reliable(10))
        .unwrap();
    let mut told = async |what| {
        let received = soon(what, goals.recv()).await;
        received.unwrap().message.data
    };
    assert_eq!(told("what was latched").await, "first");
    // received by each of its readers, handed over once
    soon(
        "connecting",
        latched.wait_for_subscribers(readers_of_both()),
    )
    .await;
    latched.publish(&text("second")).unwrap();
    assert_eq!(told("what is latched").await, "second");

    let live = talker.publisher("goal", Qos::reliable(10)).unwrap();
    soon("connecting", live.wait_for_subscribers(1)).await;
    live.publish(&text("third")).unwrap();
    assert_eq!(told("what is not latched").await, "third");
    latched.publish(&text("fourth")).unwrap();
    assert_eq!(told("what is latched").await, "fourth");
    assert_eq!((goals.lost(), goals.dropped()), (0, 0));
}

#[tokio::test(flavor = "current_thread")]
async fn nodes_of_one_context_connect_and_late_ones_get_latched() {
    let [here] = contexts();
    let (early, late) = (node(&here, "early", ""), node(&here, "late", ""));
    let state = early.publisher::<Bool>("state", Qos::latched(1)).unwrap();
    state.publish(&Bool { data: false }).unwrap();
    state.publish(&Bool { data: true }).unwrap();
    let mut states = late
        .subscription::<Bool>("state", Qos::latched(10))
        .unwrap();
    assert_eq!(
        soon("the latched message", states.recv())
            .await
            .unwrap()
            .message,
        Bool { data: true }
    );

    // Bytes that are not the type are counted, and the stream goes on.
    let raw = early
        .raw_publisher("state", "std_msgs/msg/Bool", Qos::latched(1))
        .unwrap();
    soon("connecting", async {
        raw.wait_for_subscribers(1).await;
        states.wait_for_publishers(2).await;
    })
    .await;
    raw.publish(Bytes::from_static(&[0, 1, 0, 0, 7])).unwrap();
    raw.publish(Bytes::from_static(&[0, 1, 0, 0, 0])).unwrap();
    assert_eq!(
        soon("the next message", states.recv())
            .await
            .unwrap()
            .message,
        Bool { data: false }
    );
    assert_eq!(states.undecodable(), 1);
    assert!(
        raw.publish(Bytes::from_static(&[0, 0, 0, 0, 1])).is_err(),
        "big endian cannot be sent as it is"
    );

    let waiting = tokio::spawn(async move { states.recv().await });
    early.shutdown().trigger();
    assert!(soon("the end", waiting).await.unwrap().is_none());
}

#[tokio::test(flavor = "current_thread")]
async fn services_answer_and_parameters_hold_what_is_given() {
    let [here, there] = contexts();
    let server = node(&here, "server", "--ros-args -p seed:=3");
    let seed = server
        .declare("seed", 0_i64, Descriptor::new("the seed").integers(0, 9))
        .unwrap();
    server.seal_parameters().unwrap();
    assert_eq!(seed.get(), 3);
    assert!(server.set_parameter("seed", 10_i64).is_err());
    server.set_parameter("seed", 4_i64).unwrap();
    assert_eq!(seed.get(), 4);

    let mut resets = server.service::<Reset>("~/reset").unwrap();
    server
        .serve::<Reset>("~/quick", |request| ResetResponse {
            success: request.keep_seed,
            message: request.seed.to_string(),
        })
        .unwrap();
    let client_node = node(&there, "client", "");
    let slow = client_node.client::<Reset>("/wm/server/reset").unwrap();
    let quick = client_node.client::<Reset>("server/quick").unwrap();
    soon("finding the services", async {
        slow.wait_for_service().await;
        quick.wait_for_service().await;
    })
    .await;
    let asked = ResetRequest {
        seed: 11,
        keep_seed: true,
    };
    let answer = soon("the quick answer", quick.call(&asked)).await.unwrap();
    assert_eq!(
        answer,
        ResetResponse {
            success: true,
            message: "11".into()
        }
    );
    let (answer, ()) = soon("the answer", async {
        tokio::join!(slow.call(&asked), async {
            let call = resets.recv().await.unwrap();
            assert_eq!(
                server.node_of_client(&call.client()).as_deref(),
                Some("/wm/client")
            );
            let message = format!("seed {}", call.request.seed);
            call.respond(&ResetResponse {
                success: true,
                message,
            })
            .unwrap();
        })
    })
    .await;
    assert_eq!(answer.unwrap().message, "seed 11");

    // Of several nodes in a participant, it is not known which one it was.
    let (own, other) = (server.participant(), client_node.participant());
    assert_eq!(server.node_of(own).as_deref(), Some("/wm/server"));
    let mut changes = server.graph_changes();
    let _second = node(&there, "second", "");
    soon("the second node", async {
        while server.node_of(other).is_some() {
            changes.changed().await.unwrap();
        }
    })
    .await;
    assert_eq!(server.node_of([0; 12]), None);
}

#[tokio::test(flavor = "current_thread")]
async fn a_node_follows_the_clock_of_another() {
    let [here, there] = contexts();
    let player = node(&here, "player", "");
    let follower = node(&there, "follower", "--ros-args -p use_sim_time:=true");
    assert_eq!(follower.now(), Time::default());
    let clock = player
        .publisher::<rosgraph_msgs::Clock>("/clock", Qos::reliable(1))
        .unwrap();
    soon("connecting", clock.wait_for_subscribers(1)).await;
    let mut jumps = follower.clock().jumps();
    let at = |sec| Time { sec, nanosec: 0 };
    // The first messages may come before the follower knows the player: the clock is told until it is heard.
    let tell = async |sec| {
        let follower_clock = follower.clock();
        while follower.now() != at(sec) {
            clock
                .publish(&rosgraph_msgs::Clock { clock: at(sec) })
                .unwrap();
            tokio::time::timeout(
                Duration::from_millis(50),
                follower_clock.sleep_until(at(sec)),
            )
            .await
            .ok();
        }
    };
    soon("the clock", tell(10)).await;
    soon("the jump", async { tokio::join!(tell(5), jumps.changed()) })
        .await
        .1
        .unwrap();
    assert_eq!(*jumps.borrow(), 1);
    assert_eq!(follower.now(), at(5));
}

#[tokio::test(flavor = "current_thread")]
async fn incompatible_qos_is_told_by_policy() {
    let [here, there] = contexts();
    let (talker, listener) = (node(&here, "talker", ""), node(&there, "listener", ""));
    let mut diagnostics = listener
        .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(10))
        .unwrap();
    let offered = talker
        .publisher::<Bool>("state", Qos::best_effort(1))
        .unwrap();
    let wanted = listener
        .subscription::<Bool>("state", Qos::reliable(1))
        .unwrap();
    let mut told = async |name: &str| loop {
        let report = diagnostics.recv().await.unwrap().message;
        if let Some(status) = report.status.into_iter().find(|status| status.name == name) {
            return status;
        }
    };
    // over Zenoh, QoS excludes no publisher
    let nodes: &[_] = match is_over_dds() {
        true => &["wm/talker", "wm/listener"],
        false => &[],
    };
    for node in nodes {
        let subject = format!("{node}: connections of /wm/state");
        let status = soon("the warning", told(&subject)).await;
        assert_eq!(status.level, 1);
        let text = status.message;
        assert!(text.contains("incompatible Reliability"), "{text}");
    }
    let _texts = talker
        .publisher::<std_msgs::String>("typed", Qos::reliable(1))
        .unwrap();
    let _flags = listener
        .subscription::<Bool>("typed", Qos::reliable(1))
        .unwrap();
    let subject = "wm/listener: connections of /wm/typed";
    let text = soon("the warning", told(subject)).await.message;
    for part in [
        "a publisher has the type std_msgs/msg/String",
        "this node uses std_msgs/msg/Bool",
    ] {
        assert!(text.contains(part), "{text}");
    }
    let connected = usize::from(!is_over_dds());
    let counts = (offered.subscribers(), wanted.publishers());
    assert_eq!(counts, (connected, connected));
}

#[tokio::test(flavor = "current_thread")]
async fn a_context_that_is_off_meets_nobody() {
    let domain_id = fresh_domain();
    let [here, there] = [domain_id; 2].map(context);
    let off = Context::new(&Environment {
        domain_id,
        reach: Reach::Process,
        middleware: Middleware::from_env().unwrap(),
    })
    .unwrap();
    let (alone, talker, listener) = (
        node(&off, "alone", ""),
        node(&here, "talker", ""),
        node(&there, "listener", ""),
    );
    let secret = alone.publisher::<Bool>("secret", Qos::latched(1)).unwrap();
    let overheard = alone
        .subscription::<Bool>("said", Qos::best_effort(1))
        .unwrap();
    let said = talker.publisher::<Bool>("said", Qos::reliable(1)).unwrap();
    let secrets = listener
        .subscription::<Bool>("secret", Qos::latched(1))
        .unwrap();
    let heard = listener
        .subscription::<Bool>("said", Qos::reliable(1))
        .unwrap();
    soon("the others' meeting", async {
        said.wait_for_subscribers(1).await;
        heard.wait_for_publishers(1).await;
    })
    .await;
    assert_eq!((secret.subscribers(), overheard.publishers()), (0, 0));
    assert_eq!((secrets.publishers(), said.subscribers()), (0, 1));
    // Nodes of its own process do meet.
    let beside = node(&off, "beside", "");
    let mut told = beside
        .subscription::<Bool>("secret", Qos::latched(1))
        .unwrap();
    secret.publish(&Bool { data: true }).unwrap();
    assert!(soon("the secret", told.recv()).await.unwrap().message.data);
}
