//! The nodes that compute: views, encoder, predictor, decoder, planner, evaluator and env, each `decode -> pure step -> encode`
//! over `wm_ros`.
//!
//! A node's `step` module holds its whole behaviour and uses neither DDS nor a clock: it is tested with messages alone. Its
//! `node` module is the wiring: parameters, topics, QoS, threads, diagnostics. `docs/topics.md` lists all public topics.
//!
//! Not here: the models (`wm_model`), the ROS runtime (`wm_ros`), bags (`wm_bag`).

pub mod cadence;
mod camera;
mod chunk_merging;
pub mod decoder;
pub mod encoder;
pub mod env;
pub mod evaluator;
pub mod harness;
pub mod history;
mod paced_work;
pub mod planner;
pub mod pool;
pub mod predictor;
mod processors;
mod reception;
#[cfg(test)]
mod test_world;
mod time_slice;
pub mod views;
pub mod work;

use wm_ros::NodeDefinition;

/// The registry. A node in this list is a command of `wm`, can run in `wm run`, and is in the help.
pub const NODES: &[NodeDefinition<anyhow::Error>] = &[
    views::NODE,
    encoder::NODE,
    predictor::NODE,
    decoder::NODE,
    planner::NODE,
    evaluator::NODE,
    env::NODE,
];
