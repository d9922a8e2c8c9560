use anyhow::Result;
use clap::Args;
use serde_json::json;
use wm_dataset::Dataset;
use wm_model::{Fit, Framing};
use wm_zoo::WebDinoConfig;

use super::{EncoderRecipe, EncoderTask, FILE, RECIPES, files::CONFIG_KEY};
use crate::{
    arguments::RunArgs,
    recipe::Override,
    run::{Ended, Stop},
};

/// Trains a small semantic encoder, whose features tell the actions between frames.
#[derive(Clone, Debug, Args)]
pub struct TrainEncoderArgs {
    /// What every training has.
    #[command(flatten)]
    pub run: RunArgs,
    /// How pictures of another aspect become the model's, instead of the recipe's fit: crop (the middle), stretch or pad
    /// (black bars).
    #[arg(long, value_name = "FIT")]
    pub fit: Option<Fit>,
}

impl TrainEncoderArgs {
    /// Trains until the last step, or until `stop` asks for the end.
    ///
    /// # Errors
    /// When data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<Ended> {
        let run = &self.run;
        let mut overrides = run.overrides();
        overrides.push(Override::if_open("model.name", run.model_name()));
        overrides.extend(self.fit.map(|fit| Override::new("fit", fit.name())));
        let recipe: EncoderRecipe = crate::recipe::load(RECIPES, &run.recipe, &overrides)?;
        let side = config(run, &recipe)?.image_size;
        let data = run.data(Framing::new((side, side), recipe.fit))?;
        let data = (&data.training, data.validation.as_ref());
        train_on(run, &recipe, data, stop)
    }
}

/// The encoder of the recipe, or that which is fine-tuned.
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
) -> Result<Ended> {
    let encoding = recipe.head.encoding(train.action_space())?;
    let config = config(run, recipe)?;
    let mut task = EncoderTask::new(recipe, config, &encoding, (train, held_out), run)?;
    let samples = task.clips.len();
    let data = [
        ("data", json!(train.digest())),
        ("actions", json!(encoding)),
    ];
    let settings = run.settings(recipe, samples, data)?;
    let about = format!("{} episodes, {} threads", task.clips.len(), run.threads()?);
    run.train(&mut task, recipe, &settings, (&about, stop))
}
