use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use serde_json::json;
use wm_dataset::{Dataset, HeldOutArgs};
use wm_model::{AutoencoderConfig, Encoder as _, Framing, NumberFormat};
use wm_zoo::ModelFolder;

use super::{AutoencoderRecipe, evaluate, picture, trainer::AutoencoderTask};
use crate::{
    arguments::{PictureRunArgs, RunArgs},
    run::{RunEnd, Stop},
};

/// Train the autoencoder on bags; pixels inside masks, if any, get more weight
#[derive(Args, Clone, Debug)]
pub struct TrainAutoencoderArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: PictureRunArgs,
}

impl TrainAutoencoderArgs {
    /// The recipe with overrides.
    ///
    /// # Errors
    /// Names an invalid setting.
    pub fn recipe(&self) -> Result<AutoencoderRecipe> {
        let recipe: AutoencoderRecipe = self.on.load_recipe()?;
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

    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If the data, the recipe or a file is unusable.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let run = &self.on.run;
        ensure!(
            run.device.is_cpu() && run.dtype == NumberFormat::F32,
            "the autoencoder trains on the CPU in f32; drop --device and --dtype"
        );
        let recipe = self.recipe()?;
        let framing = Framing::new((recipe.model.height, recipe.model.width), recipe.fit);
        let data = run.data(framing)?;
        let held_out = data.validation.as_ref();
        train_on(run, &recipe, &data.training, held_out, stop)
    }
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &AutoencoderRecipe,
    train: &Dataset,
    held_out: Option<&Dataset>,
    stop: &Stop,
) -> Result<RunEnd> {
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

/// Measure how well an autoencoder reconstructs the frames of held-out bags
#[derive(Args, Clone, Debug)]
pub struct EvaluateAutoencoderArgs {
    /// Evaluation data.
    #[command(flatten)]
    pub on: HeldOutArgs,
    /// The autoencoder: `tiny`, a model folder, or a file of weights
    #[arg(long)]
    pub autoencoder: PathBuf,
    /// Most frames, spread over all bags
    #[arg(long, default_value_t = 1000)]
    pub frames: usize,
    /// File for a picture with some frames, their reconstructions, and four times the difference
    #[arg(long)]
    pub picture: Option<PathBuf>,
}

impl EvaluateAutoencoderArgs {
    /// Prints the figures.
    ///
    /// # Errors
    /// If the weights or bags cannot be read, or the picture cannot be written.
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
