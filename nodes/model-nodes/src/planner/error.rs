//! The planner's errors.

use thiserror::Error;
use wm_motion::actions::ActionError;
use wm_planner::PlanError;

use crate::{history::HistoryError, predictor::PredictorError};
use wm_wire::latent_message::LatentError;

/// Why an input is dropped, or there is no plan.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlannerError {
    /// A latent message that cannot be used.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// A frame or an action that is dropped.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// Actions that cannot be encoded, or a plan that cannot be decoded.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// A dimension to search that there is not.
    #[error(
        "parameter search names the unknown dimension {name:?}; the model's dimensions are {space}"
    )]
    Searched {
        /// The name.
        name: String,
        /// The action space, in words.
        space: String,
    },
    /// Only a latent tells the inverse dynamics model anything.
    #[error(
        "the goal is words alone, which planner \"idm\" cannot plan for; expected icem, cem or mppi, alone or after idm"
    )]
    NoLatent,
    /// The settings have no JSON form.
    #[error("the plan's settings: {0}")]
    Settings(#[from] serde_json::Error),
    /// The search found nothing.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The model cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
}

impl From<PredictorError> for PlannerError {
    fn from(error: PredictorError) -> Self {
        match error {
            PredictorError::Latent(error) => Self::Latent(error),
            PredictorError::History(error) => Self::History(error),
            PredictorError::Action(error) => Self::Action(error),
            PredictorError::Model(error) => Self::Model(error),
        }
    }
}

impl PlannerError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Latent(error) => error.reason(),
            Self::History(error) => error.reason(),
            Self::Action(_) => "malformed_action",
            Self::Plan(_) | Self::Searched { .. } | Self::NoLatent | Self::Settings(_) => "no_plan",
            Self::Model(_) => "model",
        }
    }
}
