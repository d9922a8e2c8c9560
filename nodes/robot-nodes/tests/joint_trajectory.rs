//! The executor over real DDS on loopback, where it is joints that move: actions of joints in, trajectories out.

use std::{sync::LazyLock, time::Duration};

use crate::running::{node, refusal, with_nodes};
use wm_msgs::{
    builtin_interfaces::Duration as RosDuration,
    sensor_msgs::JointState,
    trajectory_msgs::JointTrajectory,
    wm_msgs::{Action, ActionChunk},
};
use wm_robot_nodes::executor;
use wm_ros::{Context, Publisher, Qos, Subscription};

/// A file of an action space of two joints, written once.
static JOINT_SPACE: LazyLock<&str> = LazyLock::new(|| {
    let path = concat!(env!("CARGO_TARGET_TMPDIR"), "/joints.yaml");
    let joint = |name| {
        format!("  - {{name: {name}, unit: rad, kind: joint_delta, scale: 1.0, clip: 1.0}}\n")
    };
    let text = format!(
        "name: two_joints\nrate: 5.0\ndimensions:\n{}{}",
        joint("a"),
        joint("b")
    );
    std::fs::write(path, text).unwrap();
    path
});

#[tokio::test(flavor = "current_thread")]
async fn actions_become_trajectories_from_where_the_joints_are() {
    let parameters = format!(
        "-p command_type:=joint_trajectory -p arm_on_start:=true -p joint_names:=[left,right] -p action_space:={}",
        *JOINT_SPACE
    );
    with_nodes(&[(&executor::NODE, &parameters)], executed).await;
}

async fn executed(here: &Context) {
    let node = node(here, "arm", "");
    let chunks: Publisher<ActionChunk> = node.publisher("action_chunk", Qos::reliable(10)).unwrap();
    let joints: Publisher<JointState> = node.publisher("joint_states", Qos::reliable(10)).unwrap();
    let mut trajectories: Subscription<JointTrajectory> = node
        .subscription("command/joint_trajectory", Qos::reliable(100))
        .unwrap();
    chunks.wait_for_subscribers(1).await;
    joints.wait_for_subscribers(1).await;
    trajectories.wait_for_publishers(1).await;
    let mut chunk = ActionChunk {
        period: RosDuration::from_nanos(200_000_000),
        ..ActionChunk::default()
    };
    let mut places = vec![0.0, 0.5];
    let mut has_moved = false;
    let mut ticks = tokio::time::interval(Duration::from_millis(20));
    loop {
        tokio::select! {
            _ = ticks.tick() => {
                let name = ["right", "left"].map(str::to_owned).to_vec();
                let position = places.iter().rev().copied().collect();
                joints.publish(&JointState { name, position, ..JointState::default() }).unwrap();
                if !has_moved {
                    chunk.header.stamp = node.now();
                    let values = vec![0.1, -0.1];
                    chunk.actions = vec![Action { header: chunk.header.clone(), values }; 5];
                    chunks.publish(&chunk).unwrap();
                }
            }
            trajectory = trajectories.recv() => {
                let trajectory = trajectory.unwrap().message;
                assert_eq!(trajectory.joint_names, ["left", "right"]);
                let [point] = &trajectory.points[..] else { panic!("{trajectory:?}") };
                assert_eq!(point.time_from_start.to_nanos(), 50_000_000);
                for ((place, velocity), before) in point.positions.iter().zip(&point.velocities).zip(&places) {
                    assert!((place - before - velocity * 0.05).abs() < 1e-9, "{trajectory:?} from {places:?}");
                }
                // The arm does what it is told.
                places.clone_from(&point.positions);
                has_moved |= places[0] > 0.1;
                if has_moved && point.velocities == [0.0; 2] {
                    break;
                }
            }
        }
    }
    assert!((places[0] + places[1] - 0.5).abs() < 1e-9, "{places:?}");
}

#[test]
fn parameters_that_contradict_each_other_are_named() {
    let of_joints = |parameters| {
        let space = *JOINT_SPACE;
        format!("-p command_type:=joint_trajectory -p action_space:={space} -p {parameters}")
    };
    for (parameters, named) in [
        ("-p command_type:=joint_trajectory", "expected joints"),
        (&*format!("-p action_space:={}", *JOINT_SPACE), "two_joints"),
        (&of_joints("joint_names:=[left]"), "expected 2"),
        (
            &of_joints("max_joint_velocity:=[1.0,1.0,1.0]"),
            "max_joint_velocity has 3",
        ),
        (
            &of_joints("joint_min:=[0.0,0.0] -p joint_max:=[1.0,0.0]"),
            "b may be from 0 to 0",
        ),
        (&of_joints("max_joint_acceleration:=[2.0]"), "stop_within"),
    ] {
        let error = refusal(&executor::NODE, parameters);
        assert!(error.contains(named), "{error}");
    }
}
