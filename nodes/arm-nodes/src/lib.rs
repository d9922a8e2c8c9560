//! The nodes that stand between plans and an arm: the executor, which turns chunks and plans into commands, an adapter, which
//! makes actions of what an arm publishes, and a simulated arm, which takes such commands where there is no real one.
//!
//! As elsewhere, a node is a pure step, which knows neither DDS nor a clock, and the wires around it.
//!
//! Not here: models (`wm_model_nodes`), the ROS runtime (`wm_ros`), inverse kinematics and controllers, which the robot
//! brings.

pub mod action_adapter;
mod displacement;
pub mod executor;
mod optional;
pub mod sim_arm;
mod space;

use wm_ros::NodeDefinition;

/// All of them.
pub const NODES: &[NodeDefinition<anyhow::Error>] =
    &[executor::NODE, action_adapter::NODE, sim_arm::NODE];
