//! `wm eval control --task`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use wm_model::trained_folder::EMBEDDED;
use wm_sim::GoalKind;

use super::{
    controller::Controller,
    settings::{ClosedLoopSettings, Goals},
};

/// Measure the success rate of a planner on the simulated arm
#[derive(Clone, Debug, Args)]
pub struct ClosedLoopArgs {
    /// Task of the arm: reach, push or pick-place; with --live, any task of the launch file's world
    #[arg(long)]
    pub task: String,
    /// Controller: cem, icem, mppi, idm, idm+cem, idm+icem, idm+mppi, subgoals+idm, subgoals+icem, oracle, hold or random
    #[arg(long, default_value = "idm+icem")]
    pub planner: Controller,
    /// Model: tiny, or a model's folder
    #[arg(long, default_value = EMBEDDED)]
    pub model: String,
    /// Use the simulator as the planner's model, for the success rate of perfect predictions
    #[arg(long)]
    pub perfect_model: bool,
    /// Number of episodes
    #[arg(long, default_value_t = 50)]
    pub episodes: usize,
    /// Seed of the first episode; each later one adds 1. The bundled model was not trained on the default
    #[arg(long, default_value_t = 5_000_000)]
    pub seed: u64,
    /// Model steps of a plan; default: 4 of idm, 1 of a search
    #[arg(long)]
    pub horizon: Option<usize>,
    /// Goal pictures given to the planner
    #[arg(long, value_enum)]
    pub goals: Option<Goals>,
    /// YAML file with settings, named as in the JSON
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// File for the findings as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Number of parallel episodes; planning times are realistic only with 1
    #[arg(long, default_value_t = 1)]
    pub parallel: usize,
    /// Run through the nodes and DDS, in real time, on the live simulated arm, with the planner's settings of the
    /// launch file
    #[arg(long, conflicts_with_all = ["perfect_model", "horizon", "goals", "settings", "parallel"])]
    pub live: bool,
    /// Launch file for --live
    #[arg(
        long,
        value_name = "FILE",
        default_value = "launch-configs/arm.launch.yaml"
    )]
    pub launch: PathBuf,
    /// Argument for the launch file of --live (repeatable)
    #[arg(long, value_name = "NAME:=VALUE", requires = "live")]
    pub launch_argument: Vec<String>,
}

impl ClosedLoopArgs {
    pub(super) fn settings(&self, task: GoalKind) -> Result<ClosedLoopSettings> {
        let mut settings = ClosedLoopSettings::of(task, self.planner);
        if let Some(path) = &self.settings {
            let name = || path.display().to_string();
            let text = std::fs::read_to_string(path).with_context(name)?;
            settings = settings.with(&text).with_context(name)?;
        }
        if let Some(horizon) = self.horizon {
            settings.horizon = horizon;
        }
        if let Some(goals) = self.goals {
            settings.goals = goals;
        }
        settings.validate()?;
        Ok(settings)
    }
}
