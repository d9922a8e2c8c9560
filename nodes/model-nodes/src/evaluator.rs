//! The evaluator node: what each of a policy's candidate chunks would do, before any is executed.
//!
//! [`EvaluatorStep`] is the node's state without its ROS interface: it keeps the goal's latent and the observed
//! history, and makes of candidates an [`EvaluationRequest`]. [`EvaluatorModel::evaluate`] predicts all candidates in
//! one batch that shares context and noise, so that they differ by their actions only, and asks the success probe,
//! where the model has one, whether each would do the [`Task`]; [`tile`] lays their pictures out, a row a candidate.

mod model;
mod node;
mod step;
mod task;
mod tile;

pub use model::{Evaluation, EvaluatorModel};
pub use node::{NODE, body};
pub use step::{EvaluationRequest, EvaluatorError, EvaluatorSettings, EvaluatorStep};
pub use task::Task;
pub use tile::{shown_steps, tile};
