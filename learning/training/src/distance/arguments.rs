use anyhow::Result;
use clap::Args;
use serde_json::json;
use wm_dataset::Latents;

use super::{DistanceRecipe, DistanceTask};
use crate::{
    arguments::{LatentRunArgs, RunArgs},
    run::{RunEnd, Stop},
    subgoals::frame_skip,
};

/// Train the distance between latents, in model steps, on the latents of a frozen encoder
#[derive(Clone, Debug, Args)]
pub struct TrainDistanceArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: LatentRunArgs,
}

impl TrainDistanceArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let run = &self.on.run;
        let recipe: DistanceRecipe = run.load_recipe([])?;
        let (folder, on) = self.on.open()?;
        let frame_skip = frame_skip(recipe.frame_skip, &folder)?;
        train_on(
            run,
            &recipe,
            frame_skip,
            (&on.train, on.held_out.as_ref()),
            stop,
        )
    }
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &DistanceRecipe,
    frame_skip: usize,
    latents: (&Latents, Option<&Latents>),
    stop: &Stop,
) -> Result<RunEnd> {
    let (train, _) = latents;
    let mut task = DistanceTask::new(recipe, frame_skip, latents, run)?;
    let data = [
        ("latent_space", json!(train.space().to_string())),
        ("data", json!(train.digest())),
        ("frame_skip", json!(frame_skip)),
    ];
    let data = (task.ways.len(), data);
    run.train_on_clips(&mut task, recipe, data, stop)
}
