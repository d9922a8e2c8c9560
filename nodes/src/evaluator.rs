//! The evaluator node: what each of a policy's candidate chunks would do, before any is executed.
//!
//! [`EvaluatorStep`] is the node's state without its wires: it keeps the goal's latent and the observed history, and makes
//! of candidates an [`EvaluationRequest`]. [`EvaluatorModel::evaluate`] predicts all candidates in one batch that shares
//! context and noise, so that they differ by their actions only; [`tile`] lays their pictures out, a row a candidate.

mod model;
mod node;
mod step;
mod tile;

pub use model::{Evaluation, EvaluatorModel};
pub use node::{NAME, body, run};
pub use step::{EvaluationRequest, EvaluatorError, EvaluatorSettings, EvaluatorStep};
pub use tile::{shown_steps, tile};
