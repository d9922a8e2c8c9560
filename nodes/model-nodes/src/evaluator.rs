//! The evaluator node: predicts and rates a policy's candidate chunks before any is executed.
//!
//! [`EvaluatorStep`] is the node's state without its ROS interface: it keeps the goal's latent and the observed
//! history, and makes of candidates an [`EvaluationRequest`]. [`EvaluatorModel::evaluate`] predicts all candidates in
//! one batch that shares context and noise, so that they differ by their actions only. If the model has a success probe, it
//! rates whether each would do the [`Task`]. [`tile`] arranges their pictures, one candidate per row.

mod model;
mod node;
mod step;
mod task;
mod tile;

pub use model::{Evaluation, EvaluatorModel};
pub use node::NODE;
pub use step::{EvaluationRequest, EvaluatorError, EvaluatorSettings, EvaluatorStep};
pub use task::Task;
pub use tile::{shown_steps, tile};
