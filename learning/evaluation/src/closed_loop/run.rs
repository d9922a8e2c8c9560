use anyhow::{Context as _, Result, ensure};

use super::{
    arguments::ClosedLoopArgs,
    controller::Controller,
    findings::{self, RunInfo},
    live,
    model::Model,
    seeds::Seeds,
    trial::{Setup, run},
};
use crate::open_model;
use wm_sim::GoalKind;

impl ClosedLoopArgs {
    /// Runs the episodes, prints and writes the findings.
    ///
    /// # Errors
    /// If the model or the settings are unusable, or the file exists.
    pub fn run(&self) -> Result<()> {
        if let Some(json) = &self.json {
            ensure!(!json.exists(), "{} exists already", json.display());
        }
        ensure!(
            !self.perfect_model || matches!(self.planner, Controller::Planner(_)),
            "--perfect-model needs a planner, but {} is none",
            self.planner
        );
        if self.live {
            return live::run(self);
        }
        let task: GoalKind = self.task.parse()?;
        let settings = self.settings(task)?;
        let model = Model::load(&open_model(&self.model)?)?;
        let frames_per_step = model.frames_per_step();
        let setup = Setup {
            task,
            controller: self.planner,
            is_perfect: self.perfect_model,
            model: Some(&model),
            frames_per_step,
            settings: &settings,
        };
        let seeds = Seeds {
            first: self.seed,
            count: self.episodes,
            parallel: self.parallel,
        };
        let trials = seeds.run("acting in", |seed| run(&setup, seed))?;
        let about = RunInfo {
            task: task.to_string(),
            planner: self.planner.to_string(),
            perfect_model: self.perfect_model,
            model: model.world.name.clone(),
            model_hash: model.world.hash.clone(),
            seed: self.seed,
            settings: settings.clone(),
            step_ms: wm_sim::STEP_S * 1e3 * frames_per_step as f64,
        };
        let findings = findings::of(about, &trials)?;
        println!("{findings}");
        if let Some(json) = &self.json {
            std::fs::write(json, findings.to_json()?)
                .with_context(|| json.display().to_string())?;
        }
        Ok(())
    }
}
