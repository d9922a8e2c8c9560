//! One episode in closed loop.

use anyhow::Result;
use wm_metrics::findings::PlanTime;
use wm_sim::{Environment, GoalKind, Variety};

use super::{actor::Actor, controller::Controller, model::Model, settings::ClosedLoopSettings};

/// Fewest model steps allowed for an episode.
pub const LEAST_STEPS: f64 = 10.0;

/// Result of an episode.
#[derive(Clone, Debug)]
pub struct Trial {
    pub seed: u64,
    pub success: bool,
    /// Model steps taken.
    pub steps: usize,
    /// Remaining distance to the goal \[m\].
    pub distance_m: f64,
    pub plans: Vec<PlanTime>,
}

/// Settings of all trials.
pub struct Setup<'a> {
    pub task: GoalKind,
    pub controller: Controller,
    /// Whether the simulator is the planner's model.
    pub is_perfect: bool,
    pub model: Option<&'a Model>,
    /// The arm's actions per model step.
    pub frames_per_step: usize,
    pub settings: &'a ClosedLoopSettings,
}

/// Acts until the goal is reached at the end of a step, or the steps are over.
pub fn run(setup: &Setup<'_>, seed: u64) -> Result<Trial> {
    let mut environment = Environment::new(setup.task, seed, &Variety::default())?;
    let frames = setup.frames_per_step;
    // An episode has a few dozen actions.
    let of_oracle = environment.solution().len() as f64 / frames as f64;
    let most = (of_oracle * setup.settings.patience).max(LEAST_STEPS) as usize;
    let mut actor = Actor::new(
        setup.controller,
        setup.is_perfect,
        setup.model,
        setup.settings,
        (&mut environment, seed),
    )?;
    let mut success = environment.solved();
    while !success && environment.steps() < most * frames {
        actor.act(&mut environment, frames)?;
        success = environment.solved();
    }
    Ok(Trial {
        seed,
        success,
        steps: environment.steps().div_ceil(frames),
        distance_m: environment.distance_m(),
        plans: actor.plans(),
    })
}
