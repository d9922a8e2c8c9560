//! Why there is no plan.

use thiserror::Error;

/// Why there is no plan.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlanError {
    /// A setting, a bound or a start that cannot serve.
    #[error("planner: {0}")]
    Setting(String),
    /// The model, or the goal's latent, does not fit.
    #[error(transparent)]
    Model(#[from] crate::Error),
    /// Not one candidate of an iteration had a finite cost.
    #[error(
        "planner: none of the {candidates} candidates of iteration {iteration} has a finite cost"
    )]
    NoFiniteCost {
        /// The iteration, from 1.
        iteration: usize,
        /// How many candidates were tried in it.
        candidates: usize,
    },
}

impl From<candle_core::Error> for PlanError {
    fn from(error: candle_core::Error) -> Self {
        Self::Model(error.into())
    }
}
