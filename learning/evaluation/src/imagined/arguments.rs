//! `wm eval imagined`.

use std::{path::PathBuf, time::Duration};

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use wm_model::trained_folder::EMBEDDED;
use wm_sim::{GoalKind, ScriptedPolicy};

use super::{
    candidate::{Candidate, NamedCommand},
    findings::{Findings, RunInfo},
    start::Setup,
};
use crate::{
    closed_loop::{model::Model, seeds::Seeds},
    open_model,
};

/// Measure whether success in imagination ranks policies as success on the simulated arm does
#[derive(Clone, Debug, Args)]
pub struct ImaginedArgs {
    /// Task of the arm: reach, push or pick-place
    #[arg(long)]
    pub task: GoalKind,
    /// Policies, the simulator's own controller and worse ones: oracle, noise-MM, distracted-PERCENT, beside-MM,
    /// slow-PERCENT, stop-PERCENT, frozen-gripper, random or hold [default: 16 of them]
    #[arg(long, num_args = 1.., value_name = "NAME")]
    pub policy: Vec<ScriptedPolicy>,
    /// A further policy: a program that answers JSON lines, as --policy-command of `wm eval policy`. It sees the pictures of
    /// the arm, and in imagination the predicted ones
    #[arg(long, value_name = "NAME=COMMAND")]
    pub policy_command: Vec<NamedCommand>,
    /// Time limit for an answer of a program \[s\]; its first answer includes loading the policy
    #[arg(long, value_name = "SECONDS", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub policy_timeout: u64,
    /// Model: tiny, or a model's folder; it needs a success probe
    #[arg(long, default_value = EMBEDDED)]
    pub model: String,
    /// Number of episodes per policy
    #[arg(long, default_value_t = 50)]
    pub episodes: usize,
    /// Seed of the first episode; each later one adds 1. The bundled model was not trained on the default
    #[arg(long, default_value_t = 5_000_000)]
    pub seed: u64,
    /// Model steps of an episode, as a multiple of the oracle's; at least ten, at most those that the success probe
    /// reads
    #[arg(long, default_value_t = 1.5)]
    pub patience: f64,
    /// File for the findings as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Number of parallel episodes
    #[arg(long, default_value_t = 1)]
    pub parallel: usize,
}

impl ImaginedArgs {
    /// Acts and imagines, prints and writes the findings.
    ///
    /// # Errors
    /// If the model is unusable, or the file exists.
    pub fn run(&self) -> Result<()> {
        if let Some(json) = &self.json {
            ensure!(!json.exists(), "{} exists already", json.display());
        }
        ensure!(
            self.patience.is_finite() && self.patience > 0.0,
            "--patience must be positive and finite, not {}",
            self.patience
        );
        let scripted = match self.policy.as_slice() {
            [] => ScriptedPolicy::ALL.as_slice(),
            chosen => chosen,
        };
        let limit = Duration::from_secs(self.policy_timeout);
        let scripted = scripted
            .iter()
            .map(|policy| Ok(Candidate::Scripted(*policy)));
        let programs = self.policy_command.iter();
        let programs = programs.map(|named| Candidate::program(named, limit));
        let candidates = scripted.chain(programs).collect::<Result<Vec<_>>>()?;
        let folder = open_model(&self.model)?;
        let probe = folder.probe()?.with_context(|| {
            format!(
                "{} has no success probe; train one with wm train probe",
                self.model
            )
        })?;
        let model = Model::load(&folder)?;
        ensure!(
            self.policy_command.is_empty() || model.decoder.is_some(),
            "{} has no decoder, but programs need pictures",
            self.model
        );
        let setup = Setup {
            task: self.task,
            candidates: &candidates,
            model: &model,
            probe: &probe,
            patience: self.patience,
        };
        let seeds = Seeds {
            first: self.seed,
            count: self.episodes,
            parallel: self.parallel,
        };
        let starts = seeds.run("acting and imagining in", |seed| setup.run(seed))?;
        let about = RunInfo {
            task: self.task.to_string(),
            model: model.world.name.clone(),
            model_hash: model.world.hash.clone(),
            seed: self.seed,
            starts: self.episodes,
            patience: self.patience,
        };
        let findings = Findings::of(about, &candidates, &starts)?;
        print!("{findings}");
        if let Some(json) = &self.json {
            std::fs::write(json, findings.to_json()?)
                .with_context(|| json.display().to_string())?;
        }
        Ok(())
    }
}
