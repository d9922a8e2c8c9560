use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use serde_json::json;
use wm_dataset::{Dataset, HeldOutArgs};
use wm_model::{AutoencoderConfig, Encoder as _, Fit, Framing, NumberFormat};
use wm_zoo::ModelFolder;

use super::{AutoencoderRecipe, RECIPES, evaluate, picture, trainer::AutoencoderTask};
use crate::{
    arguments::RunArgs,
    recipe::Override,
    run::{Ended, Stop},
};

/// Trains the autoencoder on bags of episodes. If the bags have masks, pixels inside the masks get more weight.
#[derive(Args, Clone, Debug)]
pub struct TrainAutoencoderArgs {
    /// What every training has.
    #[command(flatten)]
    pub run: RunArgs,
    /// How pictures of another aspect become the model's, instead of the recipe's fit: crop (the middle), stretch or pad
    /// (black bars).
    #[arg(long, value_name = "FIT")]
    pub fit: Option<Fit>,
}

impl TrainAutoencoderArgs {
    /// The recipe that these arguments ask for.
    ///
    /// # Errors
    /// Names what is wrong in it.
    pub fn recipe(&self) -> Result<AutoencoderRecipe> {
        let mut overrides = self.run.overrides();
        overrides.push(Override::if_open("model.name", self.run.model_name()));
        overrides.extend(self.fit.map(|fit| Override::new("fit", fit.name())));
        let recipe: AutoencoderRecipe = crate::recipe::load(RECIPES, &self.run.recipe, &overrides)?;
        ensure!(
            (0.0..=1.0).contains(&recipe.whole_picture_share),
            "whole_picture_share is {}, expected 0 to 1",
            recipe.whole_picture_share
        );
        ensure!(
            recipe.model.fit.is_stretch() && recipe.model.trained_on.is_none(),
            "model.fit and model.trained_on are written by the training; set `fit` at the top of the recipe"
        );
        Ok(recipe)
    }

    /// Trains until the last step, or until `stop` asks for the end.
    ///
    /// # Errors
    /// When the data, the recipe or a file cannot be used.
    pub fn run(&self, stop: &Stop) -> Result<Ended> {
        ensure!(
            self.run.device.is_cpu() && self.run.dtype == NumberFormat::F32,
            "the autoencoder trains on the CPU, in f32: leave --device and --dtype out"
        );
        let recipe = self.recipe()?;
        let framing = Framing::new((recipe.model.height, recipe.model.width), recipe.fit);
        let data = self.run.data(framing)?;
        let held_out = data.validation.as_ref();
        train_on(&self.run, &recipe, &data.training, held_out, stop)
    }
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &AutoencoderRecipe,
    train: &Dataset,
    held_out: Option<&Dataset>,
    stop: &Stop,
) -> Result<Ended> {
    let samples = train.episodes().len();
    let data = [("data", json!(train.digest()))];
    let settings = run.settings(recipe, samples, data)?;
    let mut recipe = recipe.clone();
    let mut old = None;
    if let Some(from) = &run.from {
        let folder = ModelFolder::open(from)?;
        let Some(trained) = folder.trained() else {
            anyhow::bail!("--from {from}: expected an autoencoder that was trained here");
        };
        let model = trained.autoencoder()?;
        recipe.model = AutoencoderConfig {
            name: recipe.model.name,
            height: recipe.model.height,
            width: recipe.model.width,
            fit: recipe.model.fit,
            trained_on: recipe.model.trained_on,
            ..model.config().clone()
        };
        old = Some(model);
    }
    let mut task = AutoencoderTask::new(recipe.clone(), settings.steps, train, held_out)?;
    if let Some(old) = &old {
        task.begin_with(old, run.groups());
    }
    let ((height, width), frames) = (train.size(), train.frame_count());
    let about = format!("{samples} episodes, {frames} frames of {height}x{width}");
    run.train(&mut task, &recipe, &settings, (&about, stop))
}

/// Measures how well an autoencoder reconstructs the frames of held-out bags.
#[derive(Args, Clone, Debug)]
pub struct EvaluateAutoencoderArgs {
    /// What to measure on.
    #[command(flatten)]
    pub on: HeldOutArgs,
    /// The autoencoder: `tiny`, a model folder, or a file of weights.
    #[arg(long)]
    pub autoencoder: PathBuf,
    /// Maximum number of frames, spread over all bags.
    #[arg(long, default_value_t = 1000)]
    pub frames: usize,
    /// Also write a picture with some frames, their reconstructions, and four times the difference.
    #[arg(long)]
    pub picture: Option<PathBuf>,
}

impl EvaluateAutoencoderArgs {
    /// Prints the figures.
    ///
    /// # Errors
    /// When the weights or the bags cannot be read, or the picture cannot be written.
    pub fn run(&self) -> Result<()> {
        let name = self.autoencoder.to_string_lossy();
        let model = ModelFolder::open(&name)?;
        let Some(trained) = model.trained() else {
            anyhow::bail!(
                "--autoencoder {name}: expected an autoencoder, found published networks"
            );
        };
        let autoencoder = trained.autoencoder()?;
        let dataset = self.on.open(autoencoder.framing())?;
        println!("{}", evaluate(&autoencoder, &dataset, self.frames)?);
        if let Some(path) = &self.picture {
            let picture = picture(&autoencoder, &dataset, 8)?;
            let saved = picture.save(path);
            saved.with_context(|| path.display().to_string())?;
        }
        Ok(())
    }
}
