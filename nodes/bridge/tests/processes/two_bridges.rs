//! Two domains, each with its bridge.

use crate::harness::{
    BRIDGE, PATIENCE, Process, Site, bridge, fresh_domain, fresh_endpoint, no_echo, program, soon,
    text,
};
use rustix::process::Signal;
use std::{process::Command, time::Duration};
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    std_msgs::String as Text,
    wm_msgs::{Reset, ResetRequest, ResetResponse},
};
use wm_ros::{Publisher, Qos, Subscription};

struct Pair {
    here: Site,
    there: Site,
    domain_here: u16,
    domain_there: u16,
    bridge_here: Process,
    _bridge_there: Process,
}

fn pair(args_here: &[&str], args_there: &[&str]) -> Pair {
    let (domain_here, domain_there) = (fresh_domain(), fresh_domain());
    let endpoint = fresh_endpoint();
    // the connecting bridge starts first: it has to retry
    let there = [&["--connect", &endpoint], args_there].concat();
    let here = [&["--listen", &endpoint], args_here].concat();
    Pair {
        _bridge_there: bridge(domain_there, &there),
        bridge_here: bridge(domain_here, &here),
        here: Site::join(domain_here),
        there: Site::join(domain_there),
        domain_here,
        domain_there,
    }
}

async fn connected(publisher: &Publisher<Text>, subscription: &Subscription<Text>) {
    soon("connecting", async {
        publisher.wait_for_subscribers(1).await;
        subscription.wait_for_publishers(1).await;
    })
    .await;
}

async fn next(subscription: &mut Subscription<Text>) -> String {
    let received = soon("a message", subscription.recv()).await;
    received.unwrap().message.data
}

#[tokio::test(flavor = "multi_thread")]
async fn topic_crosses_both_ways_without_echo() {
    let pair = pair(&[], &[]);
    let (here, there) = (&pair.here.node, &pair.there.node);
    let out = here.publisher::<Text>("said", Qos::reliable(100)).unwrap();
    let back = there.publisher::<Text>("said", Qos::reliable(100)).unwrap();
    // subscriptions of other participants than the publishers', which receive both
    let (ear_here, ear_there) = (Site::join(pair.domain_here), Site::join(pair.domain_there));
    let mut heard_here = ear_here
        .node
        .subscription::<Text>("said", Qos::reliable(100))
        .unwrap();
    let mut heard_there = ear_there
        .node
        .subscription::<Text>("said", Qos::reliable(100))
        .unwrap();
    soon("connecting", async {
        // the subscription of this side and the bridge's
        out.wait_for_subscribers(2).await;
        back.wait_for_subscribers(2).await;
        heard_here.wait_for_publishers(2).await;
        heard_there.wait_for_publishers(2).await;
    })
    .await;
    no_echo([&out, &back], [&mut heard_here, &mut heard_there]).await;

    pair.bridge_here.signal(Signal::INT);
    let status = pair.bridge_here.finish(PATIENCE);
    assert!(status.success(), "{status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn service_is_called_from_the_other_side() {
    let pair = pair(&[], &["--queries-timeout", "20"]);
    let mut service = pair.here.node.service::<Reset>("planner/reset").unwrap();
    let client = pair.there.node.client::<Reset>("planner/reset").unwrap();
    soon("finding the service", client.wait_for_service()).await;
    let serving = tokio::spawn(async move {
        for _ in 0..3 {
            let call = service.recv().await.unwrap();
            let message = format!("seed {}", call.request.seed);
            let response = ResetResponse {
                success: true,
                message,
            };
            call.respond(&response).unwrap();
        }
        service
    });
    for seed in 0..3 {
        let request = ResetRequest {
            seed,
            keep_seed: false,
        };
        let answer = soon("an answer", client.call(&request)).await.unwrap();
        assert_eq!(answer.message, format!("seed {seed}"));
    }
    // when the server ends, the remote server ends too
    drop(soon("serving", serving).await.unwrap());
    let mut changes = pair.there.node.graph_changes();
    soon("the service's end", async {
        let is_there = || {
            let endpoints = pair.there.node.remote_endpoints();
            endpoints.iter().any(|endpoint| {
                endpoint.role == wm_ros::Role::Server && endpoint.name == "/wm/planner/reset"
            })
        };
        while is_there() {
            changes.changed().await.unwrap();
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn late_subscriber_gets_latched_state() {
    let domain_here = fresh_domain();
    let domain_there = fresh_domain();
    let endpoint = fresh_endpoint();
    let (here, there) = (Site::join(domain_here), Site::join(domain_there));
    let map = here.node.publisher::<Text>("map", Qos::latched(1)).unwrap();
    map.publish(&text("new")).unwrap();

    // the bridges start after the first message
    let _bridge_here = bridge(domain_here, &["--listen", &endpoint]);
    // a router of Zenoh 1.10.2 that returns at once may get no data; a peer does
    let as_peer = ["--connect", &endpoint, "--mode", "peer"];
    let bridge_there = bridge(domain_there, &as_peer);
    let late = || there.node.subscription::<Text>("map", Qos::latched(1));
    let mut first = late().unwrap();
    assert_eq!(next(&mut first).await, "new");
    // a second subscriber later
    let mut second = late().unwrap();
    assert_eq!(next(&mut second).await, "new");
    // a third one after a restart of the other side
    drop((first, second));
    bridge_there.signal(Signal::INT);
    bridge_there.finish(PATIENCE);
    let _bridge_there = bridge(domain_there, &as_peer);
    let mut third = late().unwrap();
    assert_eq!(next(&mut third).await, "new");
    map.publish(&text("newer")).unwrap();
    assert_eq!(next(&mut third).await, "newer");
}

#[tokio::test(flavor = "multi_thread")]
async fn early_subscriber_gets_latched_sample_once() {
    let (domain_here, domain_there) = (fresh_domain(), fresh_domain());
    let endpoint = fresh_endpoint();
    let (here, there) = (Site::join(domain_here), Site::join(domain_there));
    let map = here.node.publisher::<Text>("map", Qos::latched(1)).unwrap();
    map.publish(&text("first")).unwrap();
    let qos = Qos::latched(1);
    let mut heard = there.node.subscription::<Text>("map", qos).unwrap();
    let _bridge_there = bridge(domain_there, &["--connect", &endpoint]);
    soon("the bridge", heard.wait_for_publishers(1)).await;
    let _bridge_here = bridge(domain_here, &["--listen", &endpoint]);
    assert_eq!(next(&mut heard).await, "first");
    for state in ["second", "third"] {
        map.publish(&text(state)).unwrap();
        assert_eq!(next(&mut heard).await, state);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_namespaces_and_rates_hold() {
    let pair = pair(
        &[
            "--namespace",
            "/robot1",
            "--deny",
            "/wm/secret",
            "--max-frequency",
            "/wm/fast=1",
        ],
        &[],
    );
    let (here, there) = (&pair.here.node, &pair.there.node);
    let publish = |topic: &str| here.publisher::<Text>(topic, Qos::reliable(10)).unwrap();
    let (secret, open, fast) = (publish("secret"), publish("open"), publish("fast"));
    let subscribe = |topic: &str| {
        let name = format!("/robot1/wm/{topic}");
        let subscription = there.subscription::<Text>(&name, Qos::reliable(10));
        subscription.unwrap()
    };
    let _unheard = subscribe("secret");
    let (mut heard, mut thinned) = (subscribe("open"), subscribe("fast"));
    connected(&open, &heard).await;
    connected(&fast, &thinned).await;
    for number in 0..5 {
        fast.publish(&text(&format!("fast {number}"))).unwrap();
    }
    open.publish(&text("open")).unwrap();
    assert_eq!(next(&mut heard).await, "open");
    assert_eq!(next(&mut thinned).await, "fast 0");
    assert_eq!(secret.subscribers(), 0);
    tokio::time::sleep(Duration::from_millis(1100)).await;
    fast.publish(&text("later")).unwrap();
    assert_eq!(next(&mut thinned).await, "later");
}

#[tokio::test(flavor = "multi_thread")]
async fn second_bridge_of_a_domain_takes_over_from_the_first() {
    let endpoint = fresh_endpoint();
    let (domain_here, domain_there) = (fresh_domain(), fresh_domain());
    let _router = bridge(domain_there, &["--listen", &endpoint]);
    let connect = ["--connect", endpoint.as_str()];
    // ids with a known precedence
    let configured = |id: &str| {
        let file = tempfile::Builder::new()
            .suffix(".json5")
            .tempfile()
            .unwrap();
        std::fs::write(file.path(), format!("{{ id: \"{id}\" }}")).unwrap();
        file
    };
    let (low, high) = (configured("1"), configured("f"));
    let with = |file: &tempfile::NamedTempFile| {
        let file = file.path().to_str().unwrap();
        bridge(domain_here, &[&connect[..], &["--config", file]].concat())
    };
    let (first, _second) = (with(&low), with(&high));
    let (here, there) = (Site::join(domain_here), Site::join(domain_there));
    let said = here
        .node
        .publisher::<Text>("said", Qos::reliable(100))
        .unwrap();
    let mut heard = there
        .node
        .subscription::<Text>("said", Qos::reliable(100))
        .unwrap();
    let mut reports = here
        .node
        .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(10))
        .unwrap();
    connected(&said, &heard).await;
    // until both have discovered each other, a message may arrive twice
    soon("standing by", async {
        let stands_by = |report: &DiagnosticArray| {
            let mut messages = report.status.iter().map(|status| &status.message);
            messages.any(|message| message.starts_with("standing by"))
        };
        while !stands_by(&reports.recv().await.unwrap().message) {}
    })
    .await;
    while heard.try_recv().is_some() {}
    for number in 0..20 {
        said.publish(&text(&number.to_string())).unwrap();
    }
    for number in 0..20 {
        assert_eq!(next(&mut heard).await, number.to_string());
    }
    drop(first);
    // messages during the takeover may be lost; then the topic works again
    let mut said_since = 0;
    loop {
        said.publish(&text(&format!("again {said_since}"))).unwrap();
        said_since += 1;
        let wait = tokio::time::timeout(Duration::from_millis(200), heard.recv()).await;
        if wait.is_ok_and(|received| received.is_some()) {
            break;
        }
        assert!(said_since < 150, "the second bridge does not take over");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn receiver_counts_drops_of_a_full_network() {
    // Zenoh has room for one batch of 64 KiB and does not wait for more: larger messages are usually dropped
    let config = tempfile::Builder::new()
        .suffix(".json5")
        .tempfile()
        .unwrap();
    let queue = r#"{ size: { data: 1 }, congestion_control: { drop: { wait_before_drop: 0,
        max_wait_before_drop_fragments: 0 } } }"#;
    let narrow = format!(
        "{{ transport: {{ link: {{ tx: {{ queue: {queue} }} }} }},
           plugins: {{ ros2dds: {{ reliable_routes_blocking: false }} }} }}"
    );
    std::fs::write(config.path(), narrow).unwrap();
    let carried = ["--allow", "/wm/said"];
    let file = config.path().to_str().unwrap();
    let pair = pair(&[&carried[..], &["--config", file]].concat(), &carried);
    let qos = Qos::reliable(1000);
    let said = pair.here.node.publisher::<Text>("said", qos).unwrap();
    let mut heard = pair.there.node.subscription::<Text>("said", qos).unwrap();
    let reports = Qos::reliable(10);
    let mut reports = pair
        .there
        .node
        .subscription::<DiagnosticArray>("/diagnostics", reports)
        .unwrap();
    connected(&said, &heard).await;
    // each message begins with its number; the first and last that arrive are small ones, of which any may be dropped
    // too
    let mut numbers = 0..;
    let mut say = |filling: &str| {
        let message = format!("{:04}{filling}", numbers.next().unwrap());
        said.publish(&text(&message)).unwrap();
    };
    let number = |message: &str| message[..4].parse::<u64>().unwrap();
    let mut come = Vec::new();
    let large = "x".repeat(1 << 20);
    for round in 0..3 {
        if round == 1 {
            (0..10).for_each(|_| say(&large));
        }
        let mut tries = 0..300;
        'one: loop {
            assert!(tries.next().is_some(), "{come:?} came, and nothing more");
            say("");
            let wait = Duration::from_millis(100);
            while let Ok(received) = tokio::time::timeout(wait, heard.recv()).await {
                let message = received.unwrap().message.data;
                come.push(number(&message));
                if message.len() == 4 {
                    break 'one;
                }
            }
        }
    }
    assert_eq!(heard.lost(), 0);
    let lost = come.last().unwrap() + 1 - come[0] - come.len() as u64;
    assert!(lost > 0, "{come:?} came");
    let mut counted = Vec::new();
    while counted.last() != Some(&lost) {
        let report = reports.recv();
        let report = tokio::time::timeout(PATIENCE, report).await;
        let status = report.unwrap().unwrap().message.status;
        let mut values = status.iter().flat_map(|status| &status.values);
        let count = values.find(|value| value.key.contains("said: lost in transport"));
        counted.extend(count.map(|count| count.value.parse::<u64>().unwrap()));
        assert!(counted.len() < 10, "{counted:?}, but {come:?} came");
    }
}

#[test]
fn wrong_usage_differs_from_failure() {
    let code = |args: &[&str]| {
        let output = Command::new(program(BRIDGE)).args(args).output().unwrap();
        let reason = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), reason)
    };
    let (status, reason) = code(&["--allow", "("]);
    assert_eq!(status, Some(2), "{reason}");
    assert!(reason.contains("(?:()"), "{reason}");
    let (status, reason) = code(&["--nonsense"]);
    assert_eq!(status, Some(2), "{reason}");
    let (status, reason) = code(&["--ros-args", "-r", "nonsense"]);
    assert_eq!(status, Some(2), "{reason}");
    let (status, reason) = code(&["--config", "/nonexistent.json5"]);
    assert_eq!(status, Some(1), "{reason}");
    assert!(reason.contains("/nonexistent.json5"), "{reason}");
}
