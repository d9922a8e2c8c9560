//! The actions of the package, in a module of their own: an action and a message may have the same name.

use super::{Goal, Plan as PlanMessage};
use crate::builtin_interfaces::Duration;
use serde::{Deserialize, Serialize};

/// Action: plan towards a goal, once, or again and again until it is reached or its time is over.
#[derive(Clone, Copy, Debug)]
pub struct Plan;

/// What a client of [`Plan`] requests.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanGoal {
    /// What the camera is to see.
    pub goal: Goal,
    /// 0: one plan, which comes back in the result only. Else: plan again and again, publish each plan for the
    /// executor, and end after this time.
    pub duration: Duration,
    /// End, as succeeded, when the observed distance to the last goal is at most this; 0: never.
    pub tolerance: f32,
}

/// What a goal of [`Plan`] comes to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanResult {
    /// Whether the observed distance came down to the tolerance.
    pub reached: bool,
    /// The last plan.
    pub plan: PlanMessage,
    /// Number of plans that were made.
    pub plans: u32,
    /// Why it ended.
    pub message: String,
}

/// What is told of a goal of [`Plan`] after each iteration of a search.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanFeedback {
    /// Number of the plan, from 0.
    pub plan: u32,
    /// Number of the search's iteration within the plan, from 0.
    pub iteration: u32,
    /// Cost of the best candidate so far: the weighted sum of the terms.
    pub best_cost: f32,
    /// Names of the terms of the cost, as in the message Plan.
    pub terms: Vec<String>,
    /// The cost of the best candidate term by term, weighted.
    pub term_costs: Vec<f32>,
    /// Its cost predicted with other noise, as in the message Plan; empty while it is not known.
    pub spread_costs: Vec<f32>,
    /// Number of candidates rolled out so far.
    pub candidates: u32,
    /// Mean squared latent error of the observation to the last goal.
    pub distance: f32,
}

action!(
    Plan,
    "wm_msgs",
    include_str!("../../../action/Plan.action"),
    PlanGoal,
    PlanResult,
    PlanFeedback,
    [Goal, Duration, PlanMessage]
);
