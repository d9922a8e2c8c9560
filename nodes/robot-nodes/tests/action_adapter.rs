//! The adapter over real DDS on loopback, after the simulated arm: it tells of the arm what the arm itself does.

use std::collections::BTreeMap;

use crate::running::{node, refusal, with_nodes};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{PoseStamped, TwistStamped},
    sensor_msgs::JointState,
    std_msgs::Float64,
    wm_msgs::Action,
};
use wm_robot_nodes::{action_adapter, sim_arm};
use wm_ros::{Context, Publisher, Qos, Subscription};

#[tokio::test(flavor = "current_thread")]
async fn its_actions_are_those_of_the_arm_by_poses_and_by_frames() {
    for source in [
        "-p source:=pose -p gripper:=topic",
        "-p source:=tf -p tool_frame:=tool -p gripper:=joint -p gripper_joint:=left_finger -p gripper_open:=0.04",
    ] {
        let adapter =
            format!("-r action:=adapted -p use_sim_time:=true -p base_frame:=base_link {source}");
        // Stamps of exactly 0.2 s, which a node's clock does not give.
        let arm = "-p task:=reach -p seed:=3 -p image_transport:=raw -p real_time_factor:=2.0";
        // The adapter first, so that it misses no step of the arm.
        let nodes: [(_, &str); 2] = [(&action_adapter::NODE, &adapter), (&sim_arm::NODE, arm)];
        with_nodes(&nodes, compared).await;
    }
}

async fn compared(here: &Context) {
    let node = node(here, "observer", "");
    let depth = Qos::reliable(100);
    let mut done: Subscription<Action> = node.subscription("action", depth).unwrap();
    let mut adapted: Subscription<Action> = node.subscription("adapted", depth).unwrap();
    let mut poses: Subscription<PoseStamped> = node.subscription("ee_pose", depth).unwrap();
    let twists: Publisher<TwistStamped> =
        node.publisher("command/twist", Qos::reliable(1)).unwrap();
    let gripper: Publisher<Float64> = node.publisher("command/gripper", Qos::reliable(1)).unwrap();
    twists.wait_for_subscribers(1).await;
    gripper.wait_for_subscribers(1).await;
    adapted.wait_for_publishers(1).await;
    gripper.publish(&Float64 { data: 0.25 }).unwrap();
    let mut expected = BTreeMap::new();
    let (mut compared, mut moved) = (0, 0.0);
    while compared < 12 || moved < 0.02 {
        tokio::select! {
            pose = poses.recv() => {
                let y = pose.unwrap().message.pose.position.y;
                let mut twist = TwistStamped::default();
                twist.twist.linear.y = -0.1 * y.signum();
                twist.twist.angular.z = 0.2;
                twists.publish(&twist).unwrap();
            }
            action = done.recv() => {
                let action = action.unwrap().message;
                expected.insert(action.header.stamp.to_nanos(), action.values);
            }
            action = adapted.recv() => {
                let action = action.unwrap().message;
                assert_eq!(action.header.frame_id, "base_link");
                // What the arm did came on another topic, and may be later.
                let stamp_ns = action.header.stamp.to_nanos();
                while expected.keys().next_back().is_none_or(|newest_ns| *newest_ns < stamp_ns) {
                    let action = done.recv().await.unwrap().message;
                    expected.insert(action.header.stamp.to_nanos(), action.values);
                }
                // It may have been published before anyone listened.
                let Some(values) = expected.get(&stamp_ns) else { continue };
                for (found, expected) in action.values.iter().zip(values).take(6) {
                    assert!((found - expected).abs() < 1e-5, "{:?} {values:?}", action.values);
                }
                moved += values[1].abs();
                compared += 1;
                // The gripper is where it is, not where it was told to go.
                if compared > 8 {
                    assert!((action.values[6] - 0.25).abs() < 1e-6, "{:?}", action.values);
                }
            }
        }
    }
}

/// The joints come from two publishers, as of an arm and a hand; the stamps are those of the measurement.
#[tokio::test(flavor = "current_thread")]
async fn its_actions_are_what_the_joints_did() {
    let folder = tempfile::tempdir().unwrap();
    let space = folder.path().join("space.json");
    let text = r#"{"name": "arm", "rate": 5.0, "dimensions": [
        {"name": "elbow", "unit": "rad", "kind": "joint_delta", "offset": 0.0, "scale": 1.0, "clip": 1.5},
        {"name": "thumb", "unit": "rad", "kind": "joint_position", "offset": 0.0, "scale": 1.0, "clip": 1.5}]}"#;
    std::fs::write(&space, text).unwrap();
    let adapter = format!("-p source:=joints -p action_space:={}", space.display());
    let nodes: [(_, &str); 1] = [(&action_adapter::NODE, &adapter)];
    with_nodes(&nodes, moved).await;
}

async fn moved(here: &Context) {
    let node = node(here, "observer", "");
    let depth = Qos::reliable(100);
    let mut actions: Subscription<Action> = node.subscription("action", depth).unwrap();
    let arm: Publisher<JointState> = node.publisher("joint_states", depth).unwrap();
    let hand: Publisher<JointState> = node.publisher("joint_states", depth).unwrap();
    arm.wait_for_subscribers(1).await;
    hand.wait_for_subscribers(1).await;
    actions.wait_for_publishers(1).await;
    let state = |step: i64, name: &str, position: f64| {
        let mut state = JointState {
            name: vec![name.into()],
            position: vec![position],
            ..JointState::default()
        };
        state.header.stamp = Time::from_nanos(1_700_000_000_000_000_000 + step * 100_000_000);
        state
    };
    hand.publish(&state(0, "thumb", 0.5)).unwrap();
    let mut step = 0;
    let mut ticks = tokio::time::interval(std::time::Duration::from_millis(20));
    let mut seen = 0;
    while seen < 5 {
        tokio::select! {
            _ = ticks.tick() => {
                arm.publish(&state(step, "elbow", 0.125 * step as f64)).unwrap();
                hand.publish(&state(step, "thumb", 0.5)).unwrap();
                step += 1;
            }
            action = actions.recv() => {
                assert_eq!(action.unwrap().message.values, [0.25, 0.5]);
                seen += 1;
            }
        }
    }
}

#[test]
fn parameters_that_contradict_each_other_are_named() {
    for (parameters, named) in [
        ("-p source:=tf", "expected two frames"),
        ("-p gripper:=joint", "gripper_joint is empty"),
        (
            "-p gripper:=joint -p gripper_joint:=finger -p gripper_open:=0.0",
            "two places",
        ),
        ("-p action_space:=/nowhere.json", "/nowhere.json"),
        (
            "-p source:=joints",
            "expected deltas, velocities or positions of joints",
        ),
    ] {
        let error = refusal(&action_adapter::NODE, parameters);
        assert!(error.contains(named), "{error}");
    }
}
