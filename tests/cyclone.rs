//! A real Eclipse Cyclone DDS without ROS: it receives what rclpy receives, and acts as a policy.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use serde_json::Value;

use crate::{
    harness::{Process, bundled_bag, fresh_domain, peers, rclpy, root, tool, whole_suite, wm},
    interop::{integer, messages, spaces_of_latents, spaces_of_predictions},
};

/// The predictions of `report` by observation, step and time of readiness: a chunk for a frame repeats that frame's
/// rollout.
fn predictions(report: &Value) -> BTreeMap<[i64; 3], &Value> {
    let key = |p: &Value| ["observed_stamp", "step", "ready_stamp"].map(|name| integer(&p[name]));
    let predictions = messages(report, "/wm/predicted").iter();
    predictions.map(|p| (key(p), p)).collect()
}

/// The chunk and index of this action, which its values identify.
fn announced(chunks: &[Value], action: &Value) -> Option<(usize, usize)> {
    chunks.iter().enumerate().find_map(|(number, chunk)| {
        let actions = chunk["actions"].as_array().expect("actions");
        let index = actions.iter().position(|a| a["values"] == action["values"]);
        Some((number, index?))
    })
}

#[test]
fn cyclone_receives_like_rclpy_and_its_chunks_are_predicted() {
    let Some(peers) = peers() else { return };
    let _alone = whole_suite();
    let domain = fresh_domain();
    let settings = root().join("launch-configs/config/jobs.yaml");
    let bag = format!("bag:=\"{}\"", bundled_bag().display());
    // the bag without the chunks that the player would announce: here the policy does
    let _player = Process::start(wm(
        domain,
        &[
            "player",
            "--ros-args",
            "--params-file",
            &settings.display().to_string(),
            "-p",
            &bag,
            "-p",
            "loop:=true",
            "-p",
            "action_chunk_length:=0",
            "-p",
            "goal:=false",
            "-p",
            "wait_for:=[/wm/action,/wm/latent,/wm/predicted,/wm/action_chunk]",
            "-p",
            "wait_timeout:=60.0",
        ],
    ));
    let _encoder = Process::start(wm(domain, &["encoder"]));
    let _predictor = Process::start(wm(domain, &["predictor"]));
    let cyclone = Process::start(tool(
        &peers,
        domain,
        "cyclone.py",
        &[
            "--seconds",
            "90",
            "/wm/latent:wm_msgs/msg/Latent:20",
            "/wm/predicted:wm_msgs/msg/Prediction:96",
        ],
    ));
    let rclpy = Process::start(rclpy(
        &peers,
        domain,
        "collect.py",
        &["--seconds", "90", "/wm/predicted:wm_msgs/msg/Prediction:96"],
    ));
    let report = |peer: Process| -> Value {
        let (status, stdout) = peer.finish(Duration::from_secs(120));
        assert!(status.success(), "{status}");
        serde_json::from_str(&stdout).expect("the peers print JSON")
    };
    let (cyclone, rclpy) = (report(cyclone), report(rclpy));

    assert!(messages(&cyclone, "/wm/latent").len() >= 20);
    assert!(messages(&cyclone, "/wm/predicted").len() >= 96);
    let mut spaces = spaces_of_latents(&cyclone);
    spaces.extend(spaces_of_predictions(&cyclone));
    assert_eq!(spaces.len(), 1, "one latent space: {spaces:?}");

    let (ours, theirs) = (predictions(&cyclone), predictions(&rclpy));
    let both: BTreeSet<_> = ours
        .keys()
        .filter(|&key| theirs.contains_key(key))
        .collect();
    assert!(both.len() >= 32, "only {} came to both", both.len());
    for key in both {
        assert_eq!(ours[key], theirs[key], "the two decode alike");
    }

    let chunks = cyclone["chunks"].as_array().expect("chunks");
    let mut used = BTreeSet::new();
    let mut announced_only = 0;
    for prediction in ours.values() {
        let mut chunk = None;
        for action in prediction["actions"].as_array().expect("actions") {
            let Some((number, index)) = announced(chunks, action) else {
                assert_eq!(chunk, None, "after a chunk's first action come its others");
                continue;
            };
            assert_eq!(*chunk.get_or_insert(number), number, "one chunk a rollout");
            let stamp = &chunks[number]["actions"][index]["header"]["stamp"];
            let late = integer(&action["header"]["stamp"]) - integer(stamp);
            assert!(
                late.abs() < integer(&chunks[number]["period"]) / 2,
                "action {index} of its chunk is assumed {late} ns late"
            );
        }
        announced_only += usize::from(chunk.is_some());
        used.extend(chunk);
    }
    assert!(
        announced_only >= 64 && used.len() >= 8,
        "{announced_only} predictions of {} assume the policy's chunks {used:?}",
        ours.len()
    );
}
