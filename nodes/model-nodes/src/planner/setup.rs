//! The planner's setup.

use serde::Serialize;
use wm_planner::{Arrival, PlannerChoice, PlannerSettings, Weights};

/// The planner's setup.
#[derive(Clone, Debug, Serialize)]
pub struct PlannerSetup {
    /// The planner; `None` for the fastest one that the model allows: iCEM, started by the inverse dynamics model if there is
    /// one.
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
    /// Weight of the improbability of success, for goals with words.
    pub success: f32,
    /// Weight of the model steps that remain from the plan's end to the goal, by the model's learnt distance.
    pub steps_to_goal: f32,
    /// Euler steps with which subgoals are sampled; 1 for the expected ones.
    pub subgoal_steps: usize,
    /// Seeds that the plan's cost is predicted under besides its own, for its spread.
    pub spread_seeds: usize,
    /// When one of several goals gives way to the next.
    pub arrival: Arrival,
    /// Euler steps per predicted frame; `None`: the model's own number.
    #[serde(skip)]
    pub integration_steps: Option<usize>,
    /// Names of the dimensions to search; none: all but grippers.
    #[serde(skip)]
    pub search: Vec<String>,
    /// Limits of motions.
    pub limits: MotionLimits,
}

/// Limits of the motions of a plan, besides the model's own bounds; `None` for no limit.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MotionLimits {
    /// Along each axis in one model step \[m\].
    pub translation: Option<f64>,
    /// About each axis in one model step \[rad\].
    pub rotation: Option<f64>,
    /// Change of the translation along each axis from one model step to the next \[m\].
    pub translation_change: Option<f64>,
    /// Change of the rotation about each axis from one model step to the next \[rad\].
    pub rotation_change: Option<f64>,
    /// Where the end effector may be.
    pub workspace: Option<WorkspaceBox>,
}

/// A box that the end effector is kept within, along the axes of the frame of the actions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorkspaceBox {
    /// Lower corner \[m\].
    pub min: [f64; 3],
    /// Upper corner \[m\].
    pub max: [f64; 3],
    /// Where the cost of being near a side begins \[m\], above 0.
    pub margin: f64,
    /// Weight of that cost.
    pub weight: f32,
}
