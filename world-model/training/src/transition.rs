//! Training of the transition model on the latents of a frozen encoder.
//!
//! Flow matching on clips of model steps: the first frames are history, every later frame is learned from the clean
//! frames before it, its action, and itself at a random noise level. A step's clips are split into small batches whose
//! activations stay in cache; each worker thread takes the next of them, and the gradients are summed in their order,
//! so that the result does not depend on the number of threads.

mod arguments;
mod clips;
mod evaluation;
mod objective;
mod pictures;
mod workers;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use candle_core::Var;
use indicatif::{ProgressBar, ProgressStyle};
use wm_model::{
    Autoencoder, Encoder, Weights,
    transition::{ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition, TransitionConfig},
    weights::{Precision, WeightsBuilder},
};
use wm_motion::actions::{Accumulation, ActionEncoding};

use crate::{
    dataset::Dataset,
    latents::Latents,
    loss_curve::LossCurve,
    optimiser::{AdamW, AdamWSettings, Schedule},
};
pub use arguments::{EvaluateTransitionArgs, TauDistribution, TrainTransitionArgs};
pub use clips::ClipSource;
pub use evaluation::{ActionChange, Evaluation, recover_actions};
pub use objective::Objective;
pub use pictures::{PictureErrors, StepErrors};
use workers::Workers;

/// Model steps that are predicted in an evaluation.
const HORIZON: usize = 8;
/// Windows of the evaluations during the training.
const QUICK_WINDOWS: usize = 32;

impl TrainTransitionArgs {
    /// Trains until the last step and writes the averaged weights.
    ///
    /// # Errors
    /// When data, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self) -> Result<()> {
        let encoder = self.encoder()?;
        let train = self.latents(&self.bags, &encoder)?;
        let held_out = match &self.held_out {
            Some(bags) => Some(self.latents(bags, &encoder)?),
            None => None,
        };
        let config = self.config(&train)?;
        let actions = ActionEncoding::new(
            train.action_space().clone(),
            config.action_dim,
            config.frame_skip,
            Accumulation::default(),
        )?;
        if let Some(held_out) = &held_out {
            let (own, others) = ("the training bags", "the held-out bags");
            actions
                .space()
                .expect_same(held_out.action_space(), own, others)?;
        }
        self.train(config, &actions, &train, held_out.as_ref())
    }

    fn latents(&self, bags: &Path, encoder: &(dyn Encoder + Sync)) -> Result<Latents> {
        let cache = self.cache_dir();
        let dataset = Dataset::open(bags, &cache, encoder.input_size())?;
        Latents::open(&dataset, encoder, &cache)
    }

    fn train(
        &self,
        config: TransitionConfig,
        actions: &ActionEncoding,
        train: &Latents,
        held_out: Option<&Latents>,
    ) -> Result<()> {
        std::fs::create_dir_all(&self.out).with_context(|| self.out.display().to_string())?;
        let clips = ClipSource::new(train, actions, config.max_frames)?;
        let (vars, model) = trainable(&config, self.seed)?;
        let run = self.run_description(&config, train)?;
        let settings = AdamWSettings {
            ema_decay: self.ema_decay,
            ..AdamWSettings::default()
        };
        let mut optimiser = AdamW::new(&vars, settings)?;
        let checkpoint = self.out.join("checkpoint.safetensors");
        if checkpoint.is_file() {
            optimiser.resume(&checkpoint, &run)?;
            tracing::info!(step = optimiser.steps_taken(), "resumed");
        }
        let mut curve = LossCurve::resume(&self.out, optimiser.steps_taken())?;
        let schedule = Schedule::new(
            self.learning_rate,
            self.warm_up,
            self.steps,
            self.final_rate,
        );
        let workers = Workers::new(self.threads()?)?;
        let objective = self.objective(&config)?;
        println!(
            "{} parameters, {} episodes, {} threads",
            config.parameter_count(),
            clips.len(),
            workers.len()
        );

        let progress = progress_bar(self.steps, optimiser.steps_taken());
        while optimiser.steps_taken() < self.steps {
            let step = optimiser.steps_taken();
            let (loss, gradients) = workers.step(&model, &vars, &clips, &objective, step)?;
            ensure!(loss.is_finite(), "the loss of step {step} is {loss}");
            let norm = optimiser.step(&gradients, schedule.at(step))?;
            curve.push(step, loss);
            progress.inc(1);
            progress.set_message(format!("loss {:.4} |g| {norm:.2}", curve.recent_mean(50)));
            let done = optimiser.steps_taken();
            if done.is_multiple_of(self.save_every) || done == self.steps {
                optimiser.save(&checkpoint, &run)?;
                curve.write(&self.out, "transition model: loss")?;
                let averaged = self.write(&config, actions, train, &optimiser)?;
                if let Some(held_out) = held_out {
                    let windows = if done == self.steps {
                        usize::MAX
                    } else {
                        QUICK_WINDOWS
                    };
                    let evaluation = Evaluation::new(held_out, actions, HORIZON, windows)?;
                    let ratios = evaluation.ratios(&averaged.pack()?, ActionChange::None)?;
                    let row = format!(
                        "step {done}, loss {:.4}, error / persistence at k = 1..{HORIZON}: {}",
                        curve.recent_mean(200),
                        table_row(&ratios)
                    );
                    progress.suspend(|| println!("{row}"));
                }
            }
        }
        progress.finish();
        // Also where the last step was taken by a run that ended before it could write.
        self.write(&config, actions, train, &optimiser)?;
        println!("wrote {}", self.weights_file().display());
        Ok(())
    }

    /// Writes the averaged weights, and gives the model of exactly what was written.
    fn write(
        &self,
        config: &TransitionConfig,
        actions: &ActionEncoding,
        latents: &Latents,
        optimiser: &AdamW,
    ) -> Result<Transition> {
        let mut weights = WeightsBuilder::new();
        for (name, tensor) in optimiser.ema()? {
            weights.tensor(&name, &tensor, Precision::F16)?;
        }
        weights.metadata(CONFIG_KEY, serde_json::to_string(config)?);
        weights.metadata(ACTIONS_KEY, serde_json::to_string(actions)?);
        weights.metadata(LATENT_SPACE_KEY, serde_json::to_string(latents.space())?);
        let path = self.weights_file();
        weights.write(&path)?;
        Ok(Transition::from_weights(Weights::open(&path)?)?)
    }

    fn weights_file(&self) -> PathBuf {
        self.out.join("transition.safetensors")
    }

    /// What a checkpoint must have been made for, to be resumed.
    fn run_description(&self, config: &TransitionConfig, latents: &Latents) -> Result<String> {
        let objective = self.objective(config)?;
        Ok(format!(
            "{} {} latents {} of {} seed {} rate {} warm-up {} steps {} final {} average {}",
            serde_json::to_string(config)?,
            serde_json::to_string(&objective)?,
            latents.space().hash,
            latents.digest(),
            self.seed,
            self.learning_rate,
            self.warm_up,
            self.steps,
            self.final_rate,
            self.ema_decay,
        ))
    }
}

impl EvaluateTransitionArgs {
    /// Prints latent errors against persistence for the true, the negated, no and another window's action, the PSNR of
    /// the decoded pictures against that of the last frame held, and how well planning recovers actions.
    ///
    /// # Errors
    /// When data or weights cannot be read.
    pub fn run(&self) -> Result<()> {
        let autoencoder = Autoencoder::open(&self.autoencoder)?;
        let cache = self.cache_dir();
        let dataset = Dataset::open(&self.bags, &cache, autoencoder.input_size())?;
        let latents = Latents::open(&dataset, &autoencoder, &cache)?;
        let weights = Weights::open(&self.weights)?;
        let actions: ActionEncoding = weights.json(ACTIONS_KEY)?;
        let space: wm_model::LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        space.require(latents.space())?;
        actions
            .space()
            .expect_same(latents.action_space(), "the model", "the bags")?;
        let model = Transition::from_weights(weights)?.pack()?;
        let evaluation = Evaluation::new(&latents, &actions, HORIZON, self.windows)?;
        println!(
            "{} windows; squared latent error / persistence",
            evaluation.len()
        );
        println!(
            "{:<16} {}",
            "action",
            (1..=HORIZON)
                .map(|k| format!("k={k:<5}"))
                .collect::<String>()
        );
        for change in [
            ActionChange::None,
            ActionChange::Negated,
            ActionChange::Zero,
            ActionChange::Shuffled,
        ] {
            let ratios = evaluation.ratios(&model, change)?;
            println!("{:<16} {}", change.to_string(), table_row(&ratios));
        }
        for steps in self.sampling_steps.iter().copied() {
            let mut sampler = model.config().sampler.clone();
            sampler.steps = steps;
            let ratios = evaluation.ratios_with(&model, &sampler, ActionChange::None)?;
            println!("{:<16} {}", format!("{steps} steps"), table_row(&ratios));
        }
        println!(
            "{}",
            PictureErrors::measure(&evaluation, &model, &autoencoder, &dataset)?
        );
        if self.plans > 0 {
            println!(
                "{}",
                recover_actions(&model, &actions, &evaluation, self.plans)?
            );
        }
        Ok(())
    }
}

/// A model whose tensors are variables.
fn trainable(config: &TransitionConfig, seed: u64) -> Result<(BTreeMap<String, Var>, Transition)> {
    let mut vars = BTreeMap::new();
    let model = Transition::build(config.clone(), &mut |parameter| {
        let var = Var::from_tensor(&parameter.initial(seed)?)?;
        let tensor = var.as_tensor().clone();
        vars.insert(parameter.name.clone(), var);
        Ok(tensor)
    })?;
    Ok((vars, model))
}

fn table_row(ratios: &[f64]) -> String {
    ratios.iter().map(|ratio| format!("{ratio:<7.3}")).collect()
}

fn progress_bar(steps: u64, done: u64) -> ProgressBar {
    let template = "{bar:30} {pos}/{len} {msg} {per_sec}, {eta} left";
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let progress = ProgressBar::new(steps).with_style(style);
    progress.set_position(done);
    progress.reset_eta();
    progress
}

#[cfg(test)]
mod tests;
