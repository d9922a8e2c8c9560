//! The nodes at the robot that need no model: the executor, which turns chunks and plans into commands; an adapter, which makes
//! actions of what an arm publishes; a simulated arm, which takes such commands if there is no real one; and the player and
//! the recorder of bags.
//!
//! A node is a pure step, which knows neither DDS nor a clock, and the wiring around it.
//!
//! Not here: models (`wm_model_nodes`), the ROS runtime (`wm_ros`), the format of bags (`wm_bag`), inverse kinematics and
//! controllers, which the robot brings.

pub mod action_adapter;
mod displacement;
pub mod ending;
pub mod executor;
pub mod keyboard;
pub mod learner;
mod optional;
pub mod player;
pub mod qos_overrides;
pub mod recorder;
pub mod sim_arm;
mod space;

use wm_ros::NodeDefinition;

/// All of them.
pub const NODES: &[NodeDefinition<anyhow::Error>] = &[
    executor::NODE,
    action_adapter::NODE,
    sim_arm::NODE,
    player::NODE,
    recorder::NODE,
    learner::NODE,
];
