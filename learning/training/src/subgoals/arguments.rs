use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use wm_dataset::Latents;
use wm_zoo::{ModelFolder, SUBGOALS_FILE};

use super::{SubgoalRecipe, SubgoalTask};
use crate::{
    arguments::{LatentRunArgs, RunArgs},
    fresh_weights::FreshWeights,
    run::{RunEnd, Stop},
};

/// Train the model of subgoals, which proposes latents between the present one and a goal, on the latents of a frozen
/// encoder
#[derive(Clone, Debug, Args)]
pub struct TrainSubgoalsArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: LatentRunArgs,
}

impl TrainSubgoalsArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let run = &self.on.run;
        let recipe: SubgoalRecipe = run.load_recipe([])?;
        let (folder, on) = self.on.open()?;
        let frame_skip = frame_skip(recipe.frame_skip, &folder)?;
        let fresh = match &run.from {
            Some(_) => run.fresh_weights(SUBGOALS_FILE, recipe.seed)?,
            None => from_transition(&folder, recipe.seed)?.on(&run.compute_f32()?)?,
        };
        let latents = (&on.train, on.held_out.as_ref());
        train_on(run, &recipe, (frame_skip, fresh), latents, stop)
    }
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &SubgoalRecipe,
    start: (usize, FreshWeights),
    latents: (&Latents, Option<&Latents>),
    stop: &Stop,
) -> Result<RunEnd> {
    let ((train, _), (frame_skip, _)) = (latents, &start);
    let data = [
        ("latent_space", json!(train.space().to_string())),
        ("data", json!(train.digest())),
        ("frame_skip", json!(frame_skip)),
    ];
    let mut task = SubgoalTask::new(recipe, start, latents, run)?;
    let data = (task.ways.len(), data);
    run.train_on_clips(&mut task, recipe, data, stop)
}

/// Camera frames per model step: the recipe's, or those of the model's transition model.
pub(crate) fn frame_skip(own: Option<usize>, folder: &ModelFolder) -> Result<usize> {
    match own {
        Some(own) => Ok(own),
        None if folder.has_transition() => Ok(folder.transition_tensors()?.config.frame_skip),
        None => bail!(
            "frame_skip is null, and the encoder's model has no transition model to take it from"
        ),
    }
}

/// Initial weights: the transition model's where they fit.
fn from_transition(folder: &ModelFolder, seed: u64) -> Result<FreshWeights> {
    if !folder.has_transition() {
        return Ok(FreshWeights::new(seed));
    }
    let tensors = folder.transition_tensors()?.tensors;
    Ok(FreshWeights::tuning(seed, tensors))
}
