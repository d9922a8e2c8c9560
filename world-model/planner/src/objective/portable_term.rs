//! Serialisable terms.

use serde::{Deserialize, Serialize};

use super::{ActionSize, GoalDistance, Smoothness, Target, Term, WorkspaceMargin};
use crate::{Array, PlanError, error::check_positive};

/// A term as data: all inputs of its costs except candidates and latents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum PortableTerm {
    /// [`GoalDistance`].
    GoalDistance {
        /// The latents to reach.
        target: Target<Array>,
        /// (h, w, 1), of mean 1.
        mask: Option<Array>,
    },
    /// [`ActionSize`].
    ActionSize,
    /// [`Smoothness`].
    Smoothness,
    /// [`WorkspaceMargin`].
    WorkspaceMargin {
        /// Width of the margin \[m\].
        margin: f64,
    },
}

impl PortableTerm {
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::GoalDistance { .. } => "goal",
            Self::ActionSize => "action",
            Self::Smoothness => "smoothness",
            Self::WorkspaceMargin { .. } => "workspace",
        }
    }

    pub(super) fn build(&self) -> Result<Box<dyn Term>, PlanError> {
        Ok(match self {
            Self::GoalDistance { target, mask } => {
                Box::new(GoalDistance::of_portable(target, mask.as_ref())?)
            }
            Self::ActionSize => Box::new(ActionSize),
            Self::Smoothness => Box::new(Smoothness),
            Self::WorkspaceMargin { margin } => {
                // A cast to infinity or zero is rejected too.
                check_positive("the workspace's margin", *margin as f32)?;
                Box::new(WorkspaceMargin { margin: *margin })
            }
        })
    }
}
