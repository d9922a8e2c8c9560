//! Errors of planning.

use thiserror::Error;

/// A failed plan.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlanError {
    /// An invalid setting, bound or proposal.
    #[error("planner: {0}")]
    Setting(String),
    /// A cost term that other processes cannot compute.
    #[error("planner: the term {term} of the cost needs more than the transition model")]
    NotPortable {
        /// Name of the term.
        term: &'static str,
    },
    /// A model or a goal's latent does not fit.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
    /// No candidate of an iteration had a finite cost.
    #[error(
        "planner: none of the {candidates} candidates of iteration {iteration} has a finite cost"
    )]
    NoFiniteCost {
        /// The iteration, from 1.
        iteration: usize,
        /// Candidates tried in it.
        candidates: usize,
    },
}

impl From<candle_core::Error> for PlanError {
    fn from(error: candle_core::Error) -> Self {
        Self::Model(error.into())
    }
}

pub(crate) fn check_positive(name: &str, value: f32) -> Result<(), PlanError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(PlanError::Setting(format!(
        "{name} must be positive and finite, not {value}"
    )))
}

pub(crate) fn check_share(name: &str, value: f32) -> Result<(), PlanError> {
    if (0.0..1.0).contains(&value) {
        return Ok(());
    }
    Err(PlanError::Setting(format!(
        "{name} must be at least 0 and below 1, not {value}"
    )))
}

/// Two elites are the fewest with an unbiased standard deviation.
pub(crate) fn check_elites(elites: usize, population: usize) -> Result<(), PlanError> {
    if (2..=population).contains(&elites) {
        return Ok(());
    }
    Err(PlanError::Setting(format!(
        "elites must be at least 2 and at most the population of {population}, not {elites}"
    )))
}
