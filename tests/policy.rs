//! A policy in the loop: the examples, started as by a user, with the world model.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use serde_json::Value;
use wm_bag::BagReader;
use wm_msgs::{sensor_msgs::CompressedImage, wm_msgs::Action};

use crate::harness::{
    Process, bundled_bag, fresh_domain, peers, rclpy, root, wait_for_publishers, whole_suite, wm,
};

const STEPS: u64 = 50;
/// One model step of the embedded default, and its actions at camera rate.
const STEP_NS: i64 = 400_000_000;
const ACTIONS: u64 = 2;

fn count(reader: &BagReader, topic: &str) -> u64 {
    reader.topic(topic).map_or(0, |topic| topic.message_count)
}

/// Checks that an episode's bag has all images and actions with consecutive stamps, and its origin.
fn check_episode(reader: &BagReader, seed: &str) {
    assert_eq!(count(reader, "/camera/image_raw/compressed"), STEPS + 1);
    assert_eq!(count(reader, "/wm/action"), STEPS * ACTIONS);
    assert_eq!(count(reader, "/wm/predicted"), STEPS);
    assert_eq!(count(reader, "/task/instruction"), 1);
    assert_eq!(reader.note("wm.env.seed"), Some(seed));
    assert_eq!(reader.note("wm.model_hash").map(str::len), Some(64));
    let mut images = Vec::new();
    let mut actions = Vec::new();
    for message in reader.messages() {
        let message = message.unwrap();
        match &*message.topic {
            "/camera/image_raw/compressed" => {
                let image: CompressedImage = message.decode().unwrap();
                images.push((image.header.stamp.to_nanos(), image.data));
            }
            "/wm/action" => {
                let action: Action = message.decode().unwrap();
                assert_eq!(action.header.frame_id, "base_link");
                actions.push(action.header.stamp.to_nanos());
            }
            _ => {}
        }
    }
    let first = images[0].0;
    let stamps: Vec<i64> = images.iter().map(|(stamp, _)| stamp - first).collect();
    let expected: Vec<i64> = (0..=STEPS as i64).map(|k| k * STEP_NS).collect();
    assert_eq!(stamps, expected);
    let taken: Vec<i64> = actions.iter().map(|stamp| stamp - first).collect();
    let expected: Vec<i64> = (0..(STEPS * ACTIONS) as i64)
        .map(|k| k * STEP_NS / ACTIONS as i64)
        .collect();
    assert_eq!(taken, expected);
    let different: BTreeSet<_> = images.into_iter().map(|(_, data)| data).collect();
    assert!(
        different.len() as u64 > STEPS / 2,
        "the pictures change: {}",
        different.len()
    );
}

#[test]
fn scripted_policy_plays_an_episode_by_topics() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let folder = tempfile::tempdir().unwrap();
    let output = format!("output:={}", folder.path().display());
    let bag = format!("bag:=\"{}\"", bundled_bag().display());
    let env = Process::start(wm(
        domain,
        &[
            "env",
            "--ros-args",
            "-p",
            &bag,
            "-p",
            "bag_offset:=1.0",
            "-p",
            "episodes:=1",
            "-p",
            "rate:=20.0",
            "-p",
            "seed:=5",
            "-p",
            &output,
        ],
    ));
    let images = (STEPS + 1).to_string();
    let policy = Process::start(rclpy(
        &peers,
        domain,
        "../../examples/scripted_policy.py",
        &["--images", &images],
    ));
    let (status, _) = env.finish(Duration::from_secs(180));
    assert!(
        status.success(),
        "wm env ends after its episode with 0, not {status}"
    );
    let (status, _) = policy.finish(Duration::from_secs(30));
    assert!(
        status.success(),
        "the policy has seen every image: {status}"
    );
    let reader = BagReader::open(folder.path().join("episode_000000")).unwrap();
    check_episode(&reader, "5");
}

#[test]
fn episodes_by_service_share_a_batch_and_are_identical() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let folder = tempfile::tempdir().unwrap();
    let output = format!("output:={}", folder.path().display());
    let _env = Process::start(wm(domain, &["env", "--ros-args", "-p", &output]));
    let bag = bundled_bag();
    let steps = STEPS.to_string();
    let peer = Process::start(rclpy(
        &peers,
        domain,
        "env_services.py",
        &[
            "--seconds",
            "60",
            "--bag",
            bag.to_str().unwrap(),
            "--steps",
            &steps,
            "left",
            "right",
        ],
    ));
    let (status, stdout) = peer.finish(Duration::from_secs(240));
    assert!(status.success(), "env_services.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).unwrap();
    for begun in answer["begun"].as_array().unwrap() {
        assert_eq!(begun["success"], true, "{begun}");
        assert_eq!(
            (
                begun["actions_per_step"].as_u64(),
                begun["step_period"].as_i64()
            ),
            (Some(ACTIONS), Some(STEP_NS))
        );
        assert!(
            !begun["instruction"].as_str().unwrap().is_empty(),
            "the bag's"
        );
    }
    assert_eq!(
        answer["images"]["left"].as_array().unwrap().len() as u64,
        STEPS + 1
    );
    assert_eq!(
        answer["images"]["left"], answer["images"]["right"],
        "one start, seed and actions"
    );
    assert_eq!(answer["steps"], serde_json::json!([STEPS, STEPS]));
    assert_eq!(answer["refused"][0], false);
    assert!(
        answer["refused"][1]
            .as_str()
            .unwrap()
            .contains("no episode \"nobody\"")
    );
    let timing: Vec<i64> = answer["timing"]
        .as_array()
        .unwrap()
        .iter()
        .map(|t| t.as_i64().unwrap())
        .collect();
    assert!(
        timing[1] <= timing[2] && timing[2] <= timing[3],
        "receive, start, end: {timing:?}"
    );
    for bag in answer["bags"].as_array().unwrap() {
        let reader = BagReader::open(bag.as_str().unwrap()).unwrap();
        check_episode(&reader, "3");
        assert_eq!(count(&reader, "/task/success"), 1);
    }
}

/// The last picture of the bundled bag, as a file.
fn goal_image(folder: &Path) -> PathBuf {
    let reader = BagReader::open(bundled_bag()).unwrap();
    let messages = reader.messages().map(|message| message.unwrap());
    let last = messages
        .filter(|message| &*message.topic == "/camera/image_raw/compressed")
        .last()
        .unwrap();
    let image: CompressedImage = last.decode().unwrap();
    let file = folder.join("goal.jpg");
    std::fs::write(&file, image.data).unwrap();
    file
}

#[test]
fn policy_takes_the_candidate_predicted_nearest_to_the_goal() {
    const CHOICES: usize = 5;
    // as in the example: of three candidates the movement to the side
    const SIDEWAYS: [f32; 3] = [0.02, 0.0, -0.02];
    let Some(peers) = peers() else { return };
    let _alone = whole_suite();
    let domain = fresh_domain();
    let folder = tempfile::tempdir().unwrap();
    let goal = goal_image(folder.path());
    let output = format!("output:={}", folder.path().display());
    let bag = format!("bag:=\"{}\"", bundled_bag().display());
    let steps = format!("max_steps:={}", CHOICES + 1);
    let _encoder = Process::start(wm(domain, &["encoder"]));
    // the env waits for the policy, which on a busy machine requests later than the evaluator's two seconds
    let patient = ["evaluator", "--ros-args", "-p", "max_age:=60.0"];
    let _evaluator = Process::start(wm(domain, &patient));
    // the policy leaves the first image without looking: these two must exist before it, and the env waits for it
    wait_for_publishers(domain, &["/wm/latent", "/wm/assessment"]);
    let env = Process::start(wm(
        domain,
        &[
            "env",
            "--ros-args",
            "-p",
            &bag,
            "-p",
            "episodes:=1",
            "-p",
            &steps,
            "-p",
            &output,
        ],
    ));
    wait_for_publishers(domain, &["/camera/image_raw/compressed"]);
    let images = (CHOICES + 2).to_string();
    let goal = goal.to_str().unwrap();
    let policy = Process::start(rclpy(
        &peers,
        domain,
        "../../examples/choosing_policy.py",
        &["--goal", goal, "--images", &images],
    ));
    let (status, _) = env.finish(Duration::from_secs(180));
    assert!(status.success(), "wm env: {status}");
    let (status, stdout) = policy.finish(Duration::from_secs(30));
    assert!(status.success(), "choosing_policy.py: {status}");

    let (mut chosen, mut seen) = (Vec::new(), 0);
    for line in stdout.lines() {
        let choice: Value = serde_json::from_str(line).unwrap();
        let costs = choice["costs"].as_array().unwrap().iter();
        let costs: Vec<f64> = costs.map(|cost| cost.as_f64().unwrap()).collect();
        let best = choice["best"].as_u64().unwrap() as usize;
        chosen.extend([SIDEWAYS[best]; ACTIONS as usize]);
        if costs.is_empty() {
            continue; // the first, which is taken unseen
        }
        seen += 1;
        assert_eq!(costs.len(), SIDEWAYS.len());
        assert!(
            costs.iter().all(|cost| *cost >= costs[best]) && costs[0] != costs[2],
            "{costs:?}, best {best}"
        );
    }
    assert_eq!(seen, CHOICES, "{stdout}");
    assert_eq!(chosen.len() as u64, (CHOICES as u64 + 1) * ACTIONS);
    let reader = BagReader::open(folder.path().join("episode_000000")).unwrap();
    let messages = reader.messages().map(|message| message.unwrap());
    let taken: Vec<f32> = messages
        .filter(|message| &*message.topic == "/wm/action")
        .map(|message| message.decode::<Action>().unwrap().values[1])
        .collect();
    assert_eq!(taken, chosen, "what the bag has is what was chosen");
}

#[test]
fn openvla_adapter_works_without_weights() {
    let Some(peers) = peers() else { return };
    let mut tests = Command::new(peers.join("tools/bin/python"));
    tests.arg(root().join("examples/test_openvla_policy.py"));
    let (status, _) = Process::start(tests).finish(Duration::from_secs(60));
    assert!(status.success(), "test_openvla_policy.py: {status}");
}
