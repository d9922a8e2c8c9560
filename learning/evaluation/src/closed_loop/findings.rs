//! Findings of closed loops.

use std::fmt;

use anyhow::Result;
use serde::Serialize;
use wm_metrics::findings::{ClosedLoop, Episode};

use super::{settings::ClosedLoopSettings, trial::Trial};

/// Description of the run.
#[derive(Clone, Debug, Serialize)]
pub struct RunInfo {
    pub task: String,
    pub planner: String,
    /// Whether the simulator was the planner's model.
    pub perfect_model: bool,
    pub model: String,
    pub model_hash: String,
    pub seed: u64,
    pub settings: ClosedLoopSettings,
    /// Time of a model step \[ms\].
    pub step_ms: f64,
}

/// Findings of all trials.
pub fn of(about: RunInfo, trials: &[Trial]) -> Result<ClosedLoop<RunInfo>> {
    let episode = |trial: &Trial| Episode {
        seed: trial.seed,
        success: trial.success,
        steps: trial.steps,
        distance_m: trial.distance_m,
    };
    let episodes = trials.iter().map(episode).collect();
    let plans: Vec<_> = trials
        .iter()
        .flat_map(|trial| &trial.plans)
        .copied()
        .collect();
    let step_ms = about.step_ms;
    Ok(ClosedLoop::of(about, step_ms, episodes, &plans)?)
}

impl fmt::Display for RunInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let with = match self.perfect_model {
            true => ", with the simulator as its model",
            false => "",
        };
        write!(f, "{} by {}{with}", self.task, self.planner)
    }
}
