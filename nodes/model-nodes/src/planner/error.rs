//! The planner's errors.

use thiserror::Error;
use wm_motion::actions::ActionError;
use wm_planner::PlanError;

/// Why there is no plan.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlannerError {
    /// Actions that cannot be encoded, or a plan that cannot be decoded.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// An unknown dimension to search.
    #[error(
        "parameter search names the unknown dimension {name:?}; the model's dimensions are {space}"
    )]
    Searched {
        /// The name.
        name: String,
        /// The action space, in words.
        space: String,
    },
    /// The goal has no latent, which the inverse dynamics model needs.
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

impl PlannerError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Action(_) => "malformed_action",
            Self::Plan(_) | Self::Searched { .. } | Self::NoLatent | Self::Settings(_) => "no_plan",
            Self::Model(_) => "model",
        }
    }
}
