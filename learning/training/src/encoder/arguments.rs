use anyhow::Result;
use clap::Args;
use serde_json::json;
use wm_dataset::Dataset;
use wm_model::Framing;
use wm_zoo::WebDinoConfig;

use super::{EncoderRecipe, EncoderTask, FILE, files::CONFIG_KEY};
use crate::{
    arguments::{PictureRunArgs, RunArgs},
    run::{RunEnd, Stop},
};

/// Train a small semantic encoder, whose features encode the actions between frames
#[derive(Clone, Debug, Args)]
pub struct TrainEncoderArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: PictureRunArgs,
}

impl TrainEncoderArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let run = &self.on.run;
        let recipe: EncoderRecipe = self.on.load_recipe()?;
        let side = config(run, &recipe)?.image_size;
        let data = run.data(Framing::new((side, side), recipe.fit))?;
        let data = (&data.training, data.validation.as_ref());
        train_on(run, &recipe, data, stop)
    }
}

/// The encoder of the recipe, or the fine-tuned one.
fn config(run: &RunArgs, recipe: &EncoderRecipe) -> Result<WebDinoConfig> {
    recipe.check()?;
    let old = run.old_config(FILE, CONFIG_KEY)?;
    Ok(old.unwrap_or_else(|| recipe.config()))
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &EncoderRecipe,
    (train, held_out): (&Dataset, Option<&Dataset>),
    stop: &Stop,
) -> Result<RunEnd> {
    let encoding = recipe.head.encoding(train.action_space())?;
    let config = config(run, recipe)?;
    let mut task = EncoderTask::new(recipe, config, &encoding, (train, held_out), run)?;
    let data = [
        ("data", json!(train.digest())),
        ("actions", json!(encoding)),
    ];
    let data = (task.clips.len(), data);
    run.train_on_clips(&mut task, recipe, data, stop)
}
