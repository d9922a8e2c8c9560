use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use clap::Args;
use serde_json::json;
use wm_dataset::Latents;
use wm_model::{LatentSpace, Weights, transition::LATENT_SPACE_KEY};
use wm_zoo::{
    ModelFolder,
    success_probe::{PROBE_KEY, ProbeNetworkConfig, Reader},
};

use super::{
    FRAME_SKIP_KEY, ProbeRecipe, ProbeTask, accuracy, episodes::Episodes, leave_out_unknown,
    things::Things,
};
use crate::{
    arguments::{HeldOutLatentArgs, LatentRunArgs, RunArgs},
    run::{RunEnd, Stop},
};

/// Train the success probe, which decides whether an episode's latents follow its instruction. Uses episodes with an
/// instruction (/task/instruction) and an outcome (/task/success)
#[derive(Clone, Debug, Args)]
pub struct TrainProbeArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: LatentRunArgs,
    /// Folder of the text tower for instructions: SigLIP 2 as published on Hugging Face (config.json,
    /// model.safetensors, tokenizer.json). The weights refer to the folder. Without it, the probe learns the data's
    /// words
    #[arg(long, value_name = "DIR")]
    pub text_tower: Option<PathBuf>,
}

impl TrainProbeArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let recipe: ProbeRecipe = self.on.run.load_recipe([])?;
        let (_, on) = self.on.open()?;
        let latents = (&on.train, on.held_out.as_ref());
        let things = Things::of(&on.data.training);
        let tower = self.text_tower.as_deref();
        train_on(&self.on.run, &recipe, latents, (things, tower), stop)
    }
}

impl TrainProbeArgs {
    /// [`Self::run`] if the data have both outcomes; otherwise prints why not.
    ///
    /// # Errors
    /// Those of [`Self::run`].
    pub fn run_if_labelled(&self, stop: &Stop) -> Result<RunEnd> {
        let encoder = ModelFolder::open(&self.on.encoder)?.encoder()?;
        let data = self.on.run.data(encoder.framing())?;
        let outcomes = |success| {
            let mut episodes = data.training.episodes().iter();
            episodes.any(|e| e.instruction.is_some() && e.success == Some(success))
        };
        if outcomes(true) && outcomes(false) {
            return self.run(stop);
        }
        println!("left out: the data have no instructions with both successes and failures");
        Ok(RunEnd::Finished)
    }
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &ProbeRecipe,
    (train, held_out): (&Latents, Option<&Latents>),
    (things, text_tower): (Option<Things<'_>>, Option<&Path>),
    stop: &Stop,
) -> Result<RunEnd> {
    let mut task = ProbeTask::new(recipe, (train, held_out), things, text_tower, run)?;
    let samples = task.episodes.len();
    let data = [
        ("latent_space", json!(train.space().to_string())),
        ("data", json!(train.digest())),
        ("text_tower", json!(text_tower)),
    ];
    let settings = run.settings(recipe, samples, data)?;
    let [successes, failures] = task.episodes.counts();
    let words = task.text.summary();
    let threads = run.threads()?;
    let things = match &task.things {
        Some(things) => format!("{} things that masks show, ", things.count()),
        None => String::new(),
    };
    let about =
        format!("{successes} successes, {failures} failures, {words}, {things}{threads} threads");
    let ended = run.train(&mut task, recipe, &settings, (&about, stop))?;
    if let (RunEnd::Finished, Some(best)) = (ended, &task.best) {
        println!("kept the best weights: {best}");
    }
    Ok(ended)
}

/// Measure how well a success probe separates success from failure
#[derive(Clone, Debug, Args)]
pub struct EvaluateProbeArgs {
    /// Evaluation data.
    #[command(flatten)]
    pub on: HeldOutLatentArgs,
    /// Weights of the probe
    #[arg(long)]
    pub weights: PathBuf,
}

impl EvaluateProbeArgs {
    /// Prints the figures.
    ///
    /// # Errors
    /// If data or weights cannot be read, or do not fit.
    pub fn run(&self) -> Result<()> {
        let (_, _, latents) = self.on.open()?;
        let weights = Weights::open(&self.weights)?;
        weights
            .json::<LatentSpace>(LATENT_SPACE_KEY)?
            .require(latents.space())?;
        let mut config: ProbeNetworkConfig = weights.json(PROBE_KEY)?;
        let frame_skip = weights.json(FRAME_SKIP_KEY)?;
        let reader = match config.text_features_mut() {
            Some(_) => Some(Reader::of_trained(&weights)?),
            None => None,
        };
        let mut episodes = Episodes::new(&latents, frame_skip, Some(config.max_frames()));
        if let Some(Reader::Words(words)) = &reader {
            leave_out_unknown(&mut episodes, words.config());
        }
        ensure!(
            episodes.len() > 0,
            "no episode has an instruction of known words and an outcome"
        );
        let read = |text: &str| {
            Ok(reader
                .as_ref()
                .map(|reader| reader.read(text))
                .transpose()?)
        };
        println!("{}", accuracy(&weights, &episodes, usize::MAX, read)?);
        Ok(())
    }
}
