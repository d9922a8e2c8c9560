//! A real rclpy (Fast DDS) with the suite: messages arrive, decode, and have the expected contents.

use std::{collections::BTreeSet, time::Duration};

use serde_json::Value;
use wm_msgs::sensor_msgs::Image;
use wm_ros::Qos;

use crate::harness::{
    Process, Signal, bundled_bag, fresh_domain, join, peers, rclpy, whole_suite, wm,
};

/// One model step of the embedded default: two frames of a 5 Hz camera.
const MODEL_STEP_NS: i64 = 400_000_000;
const HORIZON: u64 = 8;

/// The four nodes on a looping replay of the bundled bag, without recorder and report.
fn looping_replay(domain: u16, out: &std::path::Path) -> Process {
    Process::start(wm(
        domain,
        &[
            "launch",
            "launch-configs/replay.launch.yaml",
            "loop:=true",
            &format!("output:={}", out.display()),
        ],
    ))
}

fn collect(peers: &std::path::Path, domain: u16, topics: &[&str]) -> Value {
    let mut args = vec!["--seconds", "60"];
    args.extend(topics);
    let peer = Process::start(rclpy(peers, domain, "collect.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(90));
    assert!(status.success(), "collect.py: {status}");
    serde_json::from_str(&stdout).expect("collect.py prints JSON")
}

/// The messages of `topic` in `report`, checked not to be empty.
pub fn messages<'a>(report: &'a Value, topic: &str) -> &'a Vec<Value> {
    let messages = report["received"][topic]
        .as_array()
        .expect("every asked topic is in the answer");
    assert!(!messages.is_empty(), "nothing arrived on {topic}");
    messages
}

pub fn integer(value: &Value) -> i64 {
    value
        .as_i64()
        .unwrap_or_else(|| panic!("{value} is not an integer"))
}

fn stamps(report: &Value, topic: &str) -> BTreeSet<i64> {
    messages(report, topic)
        .iter()
        .map(|message| integer(&message["header"]["stamp"]))
        .collect()
}

fn assert_finite(values: &Value) {
    for value in values.as_array().expect("an array") {
        assert!(value.as_f64().is_some_and(f64::is_finite), "{values}");
    }
}

/// Checks the latents of `report` against the suite's defaults; returns their latent spaces.
pub fn spaces_of_latents(report: &Value) -> BTreeSet<String> {
    let mut spaces = BTreeSet::new();
    for latent in messages(report, "/wm/latent") {
        let numbers =
            integer(&latent["height"]) * integer(&latent["width"]) * integer(&latent["channels"]);
        assert_eq!(latent["dtype"], 1, "f16 is the default");
        assert_eq!(integer(&latent["data"]["len"]), numbers * 2);
        spaces.insert(latent["space"].to_string());
    }
    spaces
}

/// Checks the predictions of `report` against the suite's defaults; returns their latent spaces.
pub fn spaces_of_predictions(report: &Value) -> BTreeSet<String> {
    let mut spaces = BTreeSet::new();
    let mut steps_seen = BTreeSet::new();
    for prediction in messages(report, "/wm/predicted") {
        let step = prediction["step"].as_u64().expect("a step");
        steps_seen.insert(step);
        let observed = integer(&prediction["observed_stamp"]);
        assert_eq!(
            integer(&prediction["header"]["stamp"]) - observed,
            step as i64 * MODEL_STEP_NS
        );
        assert_eq!(integer(&prediction["step_period"]), MODEL_STEP_NS);
        assert_eq!(prediction["horizon"], HORIZON);
        assert_eq!(prediction["latent"]["header"], prediction["header"]);
        spaces.insert(prediction["latent"]["space"].to_string());
        assert!(
            !prediction["actions"]
                .as_array()
                .expect("actions")
                .is_empty()
        );
        for action in prediction["actions"].as_array().expect("actions") {
            assert_finite(&action["values"]);
        }
        assert!(integer(&prediction["received_stamp"]) >= observed);
        assert!(integer(&prediction["ready_stamp"]) >= integer(&prediction["received_stamp"]));
        assert_eq!(prediction["model_hash"].as_str().map(str::len), Some(64));
        assert!(prediction["integration_steps"].as_u64() >= Some(1));
    }
    assert_eq!(steps_seen, (1..=HORIZON).collect());
    spaces
}

/// The suite's nodes receive a large message in parts, others in one burst, of which their receive buffer may lose
/// some.
#[test]
fn large_messages_always_reach_own_nodes_and_mostly_rclpy() {
    const BYTES: usize = 300_000;
    let Some(peers) = peers() else { return };
    let _alone = whole_suite();
    let domain = fresh_domain();
    let [(here, camera), (there, viewer)] = ["camera", "viewer"].map(|name| join(domain, name));
    let qos = Qos::sensor_data();
    let publisher = camera
        .publisher::<Image>("large", qos)
        .expect("a publisher");
    let images = viewer.subscription::<Image>("large", qos);
    let mut images = images.expect("a subscription");

    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let (stop, stopped) = tokio::sync::oneshot::channel();
    let seeing = runtime.spawn(async move {
        publisher.wait_for_subscribers(1).await;
        images.wait_for_publishers(1).await;
        let mut image = Image {
            data: vec![7; BYTES],
            ..Image::default()
        };
        let mut stopped = std::pin::pin!(stopped);
        let mut tick = tokio::time::interval(Duration::from_millis(100));
        let mut seen = 0;
        loop {
            tokio::select! {
                _ = &mut stopped => return (seen, images.lost(), images.dropped()),
                _ = tick.tick() => {}
            }
            image.header.stamp.sec += 1;
            publisher.publish(&image).expect("published");
            let patience = Duration::from_secs(10);
            let came = tokio::time::timeout(patience, images.recv()).await;
            let came = came.expect("it comes in time").expect("no shutdown");
            assert!(came.message == image, "another image came, or one twice");
            seen += 1;
        }
    });
    let report = collect(&peers, domain, &["/wm/large:sensor_msgs/msg/Image:3"]);
    for image in messages(&report, "/wm/large") {
        assert_eq!(image["data"]["len"], BYTES);
    }
    stop.send(()).expect("it listens");
    let (seen, lost, dropped) = runtime.block_on(seeing).expect("no panic");
    assert!(
        seen > 3 && (lost, dropped) == (0, 0),
        "{seen} {lost} {dropped}"
    );
    drop((camera, viewer, runtime));
    for context in [here, there] {
        context.close();
    }
}

#[test]
fn every_public_topic_reaches_a_real_ros_2() {
    let Some(peers) = peers() else { return };
    let _alone = whole_suite();
    let domain = fresh_domain();
    let out = tempfile::tempdir().expect("a temporary directory");
    let _suite = looping_replay(domain, out.path());
    let report = collect(
        &peers,
        domain,
        &[
            "/camera/image_raw/compressed:sensor_msgs/msg/CompressedImage:20",
            "/wm/action:wm_msgs/msg/Action:20",
            "/wm/action_chunk:wm_msgs/msg/ActionChunk:5",
            "/wm/latent:wm_msgs/msg/Latent:20",
            "/wm/predicted:wm_msgs/msg/Prediction:80",
            "/wm/predicted/image:sensor_msgs/msg/Image:40",
            "/wm/predicted/image/compressed:sensor_msgs/msg/CompressedImage:40",
            "/wm/prediction_error:wm_msgs/msg/PredictionError:8",
            "/wm/plan:wm_msgs/msg/Plan:2",
            "/diagnostics:diagnostic_msgs/msg/DiagnosticArray:12",
            "/wm/goal/image/compressed:sensor_msgs/msg/CompressedImage:1:latched",
            "/task/instruction:std_msgs/msg/String:1:latched",
        ],
    );

    let nodes = report["nodes"].to_string();
    for node in ["/wm/encoder", "/wm/predictor", "/wm/decoder", "/wm/planner"] {
        assert!(nodes.contains(node), "{node} is not among {nodes}");
    }

    let camera = stamps(&report, "/camera/image_raw/compressed");
    let latent_stamps = stamps(&report, "/wm/latent");
    assert!(
        latent_stamps.intersection(&camera).count() >= 10,
        "latents carry the capture times of the frames: {latent_stamps:?} of {camera:?}"
    );
    let mut spaces = spaces_of_latents(&report);
    spaces.extend(spaces_of_predictions(&report));
    assert_eq!(
        spaces.len(),
        1,
        "one latent space in the whole suite: {spaces:?}"
    );

    let predicted = stamps(&report, "/wm/predicted");
    for topic in ["/wm/predicted/image", "/wm/predicted/image/compressed"] {
        let images = stamps(&report, topic);
        assert!(
            images.intersection(&predicted).count() * 2 > images.len(),
            "{topic} carries the stamps of the predictions"
        );
    }
    let image = &messages(&report, "/wm/predicted/image")[0];
    assert_eq!(image["encoding"], "rgb8");
    assert_eq!(integer(&image["step"]), integer(&image["width"]) * 3);
    let bytes = integer(&image["data"]["len"]);
    assert_eq!(bytes, integer(&image["step"]) * integer(&image["height"]));
    assert!(
        bytes < 98_000,
        "a stock subscriber takes up to 98 KB, not {bytes}"
    );

    for error in messages(&report, "/wm/prediction_error") {
        for field in ["mse", "persistence_mse"] {
            assert!(
                error[field]
                    .as_f64()
                    .is_some_and(|e| e.is_finite() && e >= 0.0),
                "{error}"
            );
        }
        let gap = integer(&error["header"]["stamp"]) - integer(&error["observed_stamp"]);
        assert_eq!(gap, integer(&error["step"]) * MODEL_STEP_NS);
    }
    for plan in messages(&report, "/wm/plan") {
        assert_finite(&plan["iteration_costs"]);
        assert!(plan["cost"].as_f64().is_some_and(f64::is_finite));
        assert!(!plan["actions"].as_array().expect("actions").is_empty());
        for action in plan["actions"].as_array().expect("actions") {
            assert_eq!(action["values"].as_array().map(Vec::len), Some(7));
            assert_finite(&action["values"]);
        }
        serde_json::from_str::<Value>(plan["settings"].as_str().expect("text"))
            .expect("settings are JSON");
    }
    for action in messages(&report, "/wm/action") {
        assert_eq!(action["values"].as_array().map(Vec::len), Some(7));
        assert_finite(&action["values"]);
    }
    let reported = report["received"]["/diagnostics"].to_string();
    for node in ["encoder", "predictor", "decoder", "planner"] {
        assert!(
            reported.contains(node),
            "{node} does not report on /diagnostics"
        );
    }
    assert!(
        !messages(&report, "/task/instruction")[0]["data"]
            .as_str()
            .expect("text")
            .is_empty()
    );

    // a peer that joins late, and one after the first has left
    for attempt in ["late", "restarted"] {
        let report = collect(&peers, domain, &["/wm/predicted:wm_msgs/msg/Prediction:8"]);
        assert!(
            messages(&report, "/wm/predicted").len() >= 8,
            "{attempt} subscriber"
        );
    }
}

#[test]
fn late_subscriber_gets_latched_samples() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let bag = format!("bag:=\"{}\"", bundled_bag().display());
    // the whole bag in a second, then silence: later messages were kept for the peer
    let _player = Process::start(wm(
        domain,
        &[
            "player",
            "--ros-args",
            "-p",
            &bag,
            "-p",
            "rate:=10.0",
            "-p",
            "linger:=120.0",
            "-p",
            "goal:=true",
            "-p",
            "wait_for:=[/wm/action]",
            "-p",
            "wait_timeout:=60.0",
        ],
    ));
    collect(&peers, domain, &["/wm/action:wm_msgs/msg/Action:45"]);
    for attempt in ["late", "restarted"] {
        let report = collect(
            &peers,
            domain,
            &[
                "/wm/goal/image/compressed:sensor_msgs/msg/CompressedImage:1:latched",
                "/task/instruction:std_msgs/msg/String:1:latched",
            ],
        );
        for topic in ["/wm/goal/image/compressed", "/task/instruction"] {
            assert_eq!(
                messages(&report, topic).len(),
                1,
                "{topic}, {attempt} subscriber"
            );
        }
    }
}

#[test]
fn parameters_are_visible_and_guarded() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let predictor = Process::start(wm(
        domain,
        &[
            "predictor",
            "--ros-args",
            "-p",
            "horizon:=3",
            "-r",
            "__ns:=/arm1",
        ],
    ));
    let peer = Process::start(rclpy(
        &peers,
        domain,
        "parameters.py",
        &[
            "--seconds",
            "20",
            "/arm1/predictor",
            "--set",
            "horizon=\"eight\"",
            "--set",
            "no_such_parameter=1",
        ],
    ));
    let (status, stdout) = peer.finish(Duration::from_secs(60));
    assert!(status.success(), "parameters.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("parameters.py prints JSON");
    let horizon = &answer["parameters"]["horizon"];
    assert_eq!(horizon["value"], 3);
    assert!(!horizon["description"].as_str().expect("text").is_empty());
    for (set, name) in answer["sets"]
        .as_array()
        .expect("two answers")
        .iter()
        .zip(["horizon", "no_such_parameter"])
    {
        assert_eq!(set["successful"], false);
        assert!(
            set["reason"].as_str().expect("text").contains(name),
            "{set}"
        );
    }
    predictor.signal(Signal::INT);
    let (status, _) = predictor.finish(Duration::from_secs(30));
    assert!(
        status.success(),
        "a node that is asked to stop exits with 0, not {status}"
    );
}

#[test]
fn node_reports_types_and_loggers_and_sets_atomically() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let _decoder = Process::start(wm(domain, &["decoder"]));
    let args = ["--seconds", "20", "/wm/decoder"];
    let peer = Process::start(rclpy(&peers, domain, "introspection.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(60));
    assert!(status.success(), "introspection.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("introspection.py prints JSON");

    let described = &answer["of_node"];
    assert_eq!(described["successful"], true, "{described}");
    assert_eq!(described["parts"], answer["of_installation"]);
    assert_eq!(answer["unused"]["successful"], false);

    let loggers = &answer["loggers"];
    assert_eq!(loggers["before"][""], 20, "{loggers}");
    assert_eq!(loggers["set"][0][0], true, "{loggers}");
    assert_eq!(loggers["set"][1][0], false, "25 is no level: {loggers}");
    assert_eq!(loggers["after"]["wm_ros.dds"], 10, "{loggers}");
    assert_eq!(loggers["after"]["wm.encoder"], 0, "{loggers}");

    let changes = answer["atomic"].as_array().expect("three answers");
    let [out_of_range, read_only, right] = &changes[..] else {
        panic!("{changes:?}")
    };
    for (change, name) in [(out_of_range, "jpeg_quality"), (read_only, "decode_period")] {
        assert_eq!(change["successful"], false, "{change}");
        assert!(change["reason"].as_str().expect("text").contains(name));
        assert_eq!(change["steps"], serde_json::json!([]), "none was made");
    }
    assert_eq!(right["successful"], true, "{right}");
    assert_eq!(right["steps"], serde_json::json!([4, 8]));
    assert_eq!(right["jpeg_quality"], 70);
    // integer array, integer, double
    assert_eq!(answer["types"], serde_json::json!([7, 2, 3]));
    let descriptors = &answer["descriptors"];
    assert_eq!(descriptors[1]["integers"], serde_json::json!([[1, 100]]));
    assert_eq!(
        descriptors[2]["doubles"],
        serde_json::json!([[0.0, 3600.0]])
    );
    assert_eq!(descriptors[2]["read_only"], true);
    assert_eq!(descriptors[0]["read_only"], false);
}

/// Review C2.2: each round left the previous endpoints in the graph of Fast DDS, and a call to an inactive node hung.
#[test]
fn inactive_node_keeps_endpoints_and_refuses_calls() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let _predictor = Process::start(wm(
        domain,
        &["predictor", "--ros-args", "-p", "autostart:=false"],
    ));
    let args = ["--seconds", "20", "--rounds", "3", "/wm/predictor"];
    let peer = Process::start(rclpy(&peers, domain, "endpoints.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(120));
    assert!(status.success(), "endpoints.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("endpoints.py prints JSON");
    let rounds = answer["rounds"].as_array().expect("rounds");
    assert_eq!(rounds.len(), 4, "{answer}");
    for round in rounds {
        assert_eq!(round["publishers"], 1, "of /wm/predicted: {answer}");
        assert_eq!(round["subscriptions"], 1, "of /wm/latent: {answer}");
        assert_eq!(round["servers"], 1, "of ~/reset: {answer}");
        let refusal = &round["inactive"];
        assert_eq!(refusal["success"], false, "{answer}");
        let message = refusal["message"].as_str().expect("a message");
        assert!(message.contains("not active"), "{message}");
    }
    for round in &rounds[1..] {
        assert_eq!(round["active"]["success"], true, "{answer}");
    }
}

#[test]
fn rclpy_drives_a_node_through_its_lifecycle() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let encoder = Process::start(wm(
        domain,
        &["encoder", "--ros-args", "-p", "autostart:=false"],
    ));
    let asked = [
        ("activate", false, "unconfigured"),
        ("configure", true, "inactive"),
        ("activate", true, "active"),
        ("configure", false, "active"),
        ("deactivate", true, "inactive"),
        ("activate", true, "active"),
        ("deactivate", true, "inactive"),
        ("cleanup", true, "unconfigured"),
        ("configure", true, "inactive"),
        ("shutdown", true, "finalized"),
    ];
    let mut args = vec!["--seconds", "20", "--output"];
    args.extend(["/wm/latent:wm_msgs/msg/Latent", "/wm/encoder"]);
    args.extend(asked.map(|(label, ..)| label));
    let peer = Process::start(rclpy(&peers, domain, "lifecycle.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(120));
    assert!(status.success(), "lifecycle.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("lifecycle.py prints JSON");

    let made = answer["made"].as_array().expect("an answer to each");
    assert_eq!(made.len(), asked.len());
    for (step, (label, success, state)) in made.iter().zip(asked) {
        assert_eq!(step["success"], success, "{label}: {step}");
        if label != "shutdown" {
            assert_eq!(step["state"], state, "{label}: {step}");
            let messages = step["messages"].as_u64().expect("a count");
            assert_eq!(messages >= 3, state == "active", "latents after {step}");
            assert!(state == "active" || messages == 0, "latents after {step}");
        }
    }
    assert_eq!(
        made[1]["available"],
        serde_json::json!(["cleanup", "activate", "shutdown"])
    );
    // each transition has two steps
    let goals: Vec<&str> = answer["events"]
        .as_array()
        .expect("events")
        .iter()
        .map(|event| event[1][1].as_str().expect("a label"))
        .collect();
    let expected = asked.iter().filter(|(_, success, _)| *success);
    let expected: Vec<&str> = expected
        .flat_map(|(label, _, state)| {
            let during = match *label {
                "configure" => "configuring",
                "activate" => "activating",
                "deactivate" => "deactivating",
                "cleanup" => "cleaningup",
                _ => "shuttingdown",
            };
            [during, *state]
        })
        .collect();
    assert_eq!(goals, expected);
    assert_eq!(answer["of_node"], answer["of_rclpy"]);

    let (status, _) = encoder.finish(Duration::from_secs(30));
    assert!(
        status.success(),
        "a node that is shut down exits with 0, not {status}"
    );
}
