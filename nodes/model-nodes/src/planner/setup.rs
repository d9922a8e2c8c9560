//! How to plan.

use serde::Serialize;
use wm_planner::{PlannerChoice, PlannerSettings};

/// How to plan.
#[derive(Clone, Debug, Serialize)]
pub struct PlannerSetup {
    /// Which planner; `None` for the fastest one that the model allows: iCEM, from what the inverse dynamics model tells
    /// where there is one.
    #[serde(skip)]
    pub choice: Option<PlannerChoice>,
    /// Settings of all planners.
    #[serde(skip)]
    pub settings: PlannerSettings,
    /// Model steps of a plan.
    pub horizon: usize,
    /// Candidates rolled out at once.
    pub batch: usize,
    /// Weights of the cost's terms.
    pub weights: Weights,
    /// Seeds that the plan's cost is predicted under besides its own, for its spread.
    pub spread_seeds: usize,
}

/// Weights of the cost's terms; 0 leaves a term out.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Weights {
    /// Distance to the goal after the last step.
    pub goal: f32,
    /// Mean distance to the goal over all steps.
    pub path: f32,
    /// Size of the actions.
    pub action: f32,
    /// Change from one action to the next.
    pub smoothness: f32,
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            goal: 1.0,
            path: 0.0,
            action: 0.0,
            smoothness: 0.0,
        }
    }
}
