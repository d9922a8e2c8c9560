//! `examples/gym`: an environment of gymnasium as a camera and an arm, and the imagined one with its interface.

// each test has its own runtime, in which nothing else takes the lock
#![allow(clippy::await_holding_lock)]

use std::{path::Path, process::Command, time::Duration};

use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::Image,
    std_msgs::{Bool, String as Text},
    wm_msgs::{Action, Reset, ResetRequest},
};
use wm_ros::Qos;

use crate::harness::{
    Process, Signal, bundled_bag, example, fresh_domain, join, peers, root, wm_node,
};

/// Far longer than needed; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(90);

/// A program of `examples/gym`, with gymnasium.
fn gym(peers: &Path, domain: u16, script: &str, args: &[&str]) -> Command {
    let script = format!("gym/{script}");
    let mut command = example(peers, "gymnasium", domain, &script, args);
    // pygame draws without a screen
    command.env("SDL_VIDEODRIVER", "dummy");
    command
}

#[test]
fn commands_and_worlds_pass_their_own_tests() {
    let Some(peers) = peers() else { return };
    let tests = gym(&peers, fresh_domain(), "test_gym_node.py", &[]);
    let (status, _) = Process::start(tests).finish(PATIENCE);
    assert!(status.success(), "{status}");
}

#[test]
fn gymnasium_accepts_the_imagined_environment() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let bag = bundled_bag().display().to_string();
    let out = tempfile::tempdir().expect("a temporary directory");
    let [episodes, starts] = [
        format!("output:={}", out.path().display()),
        format!("start_root:={}", root().display()),
    ];
    let env = Process::start(wm_node(domain, "env", &[&episodes, &starts]));
    let tests = gym(&peers, domain, "test_imagined.py", &[&bag]);
    let (status, _) = Process::start(tests).finish(PATIENCE);
    assert!(status.success(), "{status}");
    env.signal(Signal::INT);
    let (status, _) = env.finish(PATIENCE);
    assert!(status.success(), "{status}");
}

#[tokio::test(flavor = "current_thread")]
async fn environment_is_a_camera_and_an_arm() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let program = gym(&peers, domain, "gym_node.py", &["gym:Pendulum-v1"]);
    let program = Process::start(program);
    let (_context, node) = join(domain, "robot");
    let mut pictures = node
        .subscription::<Image>("/camera/image_raw", Qos::best_effort(4))
        .unwrap();
    let mut actions = node
        .subscription::<Action>("action", Qos::reliable(10))
        .unwrap();
    let mut instructions = node
        .subscription::<Text>("/task/instruction", Qos::latched(1))
        .unwrap();
    let mut successes = node
        .subscription::<Bool>("/task/success", Qos::latched(1))
        .unwrap();
    let mut diagnostics = node
        .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(10))
        .unwrap();
    let commands = node
        .publisher::<Action>("command/action", Qos::reliable(10))
        .unwrap();
    let resets = node.client::<Reset>("gym/reset").unwrap();
    let work = async {
        resets.wait_for_service().await;
        let request = ResetRequest {
            seed: 7,
            keep_seed: false,
        };
        let answer = resets.call(&request).await.unwrap();
        assert!(answer.success, "{}", answer.message);
        let instruction = instructions.recv().await.unwrap().message;
        assert_eq!(instruction.data, "Pendulum-v1");
        assert!(!successes.recv().await.unwrap().message.data);

        // a commanded action is published with the stamp of the picture before it
        let first = pictures.recv().await.unwrap().message;
        assert_eq!((first.height, first.width, first.step), (128, 128, 384));
        assert_eq!(first.data.len(), 128 * 384);
        let torque = Action {
            values: vec![1.5],
            ..Action::default()
        };
        let published = loop {
            commands.publish(&torque).unwrap();
            let next = tokio::time::timeout(Duration::from_millis(100), actions.recv());
            if let Ok(action) = next.await {
                break action.unwrap().message;
            }
        };
        assert_eq!(published.values, [1.5]);
        let is_next = loop {
            let picture = pictures.recv().await.unwrap().message;
            let age = picture.header.stamp.to_nanos() - published.header.stamp.to_nanos();
            if age > 0 {
                break age % 200_000_000 == 0;
            }
        };
        assert!(is_next, "pictures are 0.2 s apart, an action begins at one");

        // an action of another length moves nothing, and is counted
        let wrong = Action {
            values: vec![0.0; 7],
            ..Action::default()
        };
        loop {
            commands.publish(&wrong).unwrap();
            let array = diagnostics.recv().await.unwrap().message;
            let mut values = array.status.iter().flat_map(|status| &status.values);
            if values.any(|value| value.key == "dropped: wrong_length [total]") {
                break;
            }
        }
    };
    let done = tokio::time::timeout(PATIENCE, work).await.is_ok();
    assert!(done, "not within {PATIENCE:?}");
    program.signal(Signal::INT);
    let (status, _) = program.finish(PATIENCE);
    assert!(status.success(), "{status}");
}
