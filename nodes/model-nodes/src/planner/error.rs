//! The planner's errors.

use thiserror::Error;
use wm_motion::actions::ActionError;
use wm_planner::{PlanError, PlannerChoice};
use wm_wire::latent_message::LatentError;

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
        "the goal is words alone, for which only planners that search can plan; expected icem, cem or mppi, alone or after idm"
    )]
    NoLatent,
    /// The planner needs a model of subgoals.
    #[error(
        "planner {planner} needs a model of subgoals; train one with wm train subgoals, or choose another planner"
    )]
    NoSubgoals {
        /// The planner.
        planner: PlannerChoice,
    },
    /// The subgoals are for other model steps.
    #[error(
        "the model of subgoals was trained for model steps of {found} camera frames, but those of the transition model have {expected}"
    )]
    SubgoalSteps {
        /// Camera frames per step of the transition model.
        expected: usize,
        /// Camera frames per step of the subgoals.
        found: usize,
    },
    /// The cost needs a learnt distance.
    #[error(
        "steps_weight is above 0, but the model has no learnt distance; train one with wm train distance"
    )]
    NoDistance,
    /// A proposed subgoal that no message can hold.
    #[error("the subgoals: {0}")]
    Subgoals(#[from] LatentError),
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
            Self::Plan(_)
            | Self::Searched { .. }
            | Self::NoLatent
            | Self::NoSubgoals { .. }
            | Self::SubgoalSteps { .. }
            | Self::NoDistance
            | Self::Settings(_) => "no_plan",
            Self::Model(_) | Self::Subgoals(_) => "model",
        }
    }
}
