use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use wm_zoo::{Checkpoint, ModelFolder};

use super::{AdapterRecipe, AdapterTask, Data, FILE, Frames, Lpips, files};
use crate::{
    arguments::RunArgs,
    run::{RunEnd, Stop},
};

/// Train the S-VAE adapter, which compresses the features of a frozen encoder, and its pixel decoder
#[derive(Clone, Debug, Args)]
pub struct TrainAdapterArgs {
    /// Options of every training.
    #[command(flatten)]
    pub run: RunArgs,
    /// Model whose frozen encoder makes the features: tiny, or a model's folder without adapter and normalisation
    #[arg(long)]
    pub encoder: String,
    /// AlexNet as named by torchvision, for LPIPS: a safetensors or torch file
    #[arg(long, requires = "lpips_heads")]
    pub lpips_trunk: Option<PathBuf>,
    /// Linear heads of LPIPS v0.1 for AlexNet
    #[arg(long, requires = "lpips_trunk")]
    pub lpips_heads: Option<PathBuf>,
}

impl TrainAdapterArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let run = &self.run;
        let recipe: AdapterRecipe = run.load_recipe([])?;
        recipe.check()?;
        let folder = ModelFolder::open(&self.encoder)?;
        let encoder = folder.encoder()?;
        let description = self.description(&folder, encoder.input_size().1, recipe.views)?;
        let on = run.encoded(&*encoder)?;
        let held_out = on.data.validation.as_ref().zip(on.held_out.as_ref());
        let data = Data {
            train: Frames::new(&on.data.training, &on.train)?,
            held_out: held_out
                .map(|(dataset, latents)| Frames::new(dataset, latents))
                .transpose()
                .context("the episodes for validation")?,
            lpips: match (&self.lpips_trunk, &self.lpips_heads) {
                (Some(trunk), Some(heads)) => Some(Lpips::open(trunk, heads)?.on(&run.device()?)?),
                _ => None,
            },
            start: self.start().map(Checkpoint::open).transpose()?,
            description,
        };
        if recipe.loss.lpips > 0.0 && data.lpips.is_none() {
            println!(
                "LPIPS is left out of the pixel loss: it needs --lpips-trunk and --lpips-heads"
            );
        }
        train_on(run, &recipe, &data, self.files()?, stop)
    }

    /// Weights to start from: an adapter.safetensors (a file, or in a model's folder), or a published checkpoint.
    fn start(&self) -> Option<PathBuf> {
        let from = Path::new(self.run.from.as_deref()?);
        Some(match from.is_dir() {
            true => from.join(FILE),
            false => from.to_owned(),
        })
    }

    /// The description of the encoder's folder for the trained model. `width` is that of the encoder's input.
    fn description(
        &self,
        folder: &ModelFolder,
        width: usize,
        views: usize,
    ) -> Result<Option<Value>> {
        let Some(described) = folder.described() else {
            return Ok(None);
        };
        let of_folder = described.description();
        for (key, is_there) in [
            ("adapter", of_folder.adapter.is_some()),
            ("normalisation", of_folder.normalisation.is_some()),
        ] {
            ensure!(
                !is_there,
                "{}: model.json has `{key}`, but an adapter reads an encoder's features as they are; give a folder \
                 whose model.json has none",
                self.encoder
            );
        }
        let [_, of_view] = of_folder.image;
        let found = width / of_view.max(1);
        ensure!(
            found == views,
            "{}: its pictures have {found} views, the recipe says views: {views}",
            self.encoder
        );
        files::encoder_of(Path::new(&self.encoder), &self.run.model_name()).map(Some)
    }

    /// Contents of further files that affect the result.
    fn files(&self) -> Result<Value> {
        let digest = |path: &Option<PathBuf>| -> Result<Option<String>> {
            let Some(path) = path else { return Ok(None) };
            let mut hash = Sha256::new();
            let copied =
                std::fs::File::open(path).and_then(|mut file| std::io::copy(&mut file, &mut hash));
            copied.with_context(|| path.display().to_string())?;
            Ok(Some(format!("{:x}", hash.finalize())))
        };
        Ok(json!({
            "start": digest(&self.start())?,
            "lpips_trunk": digest(&self.lpips_trunk)?,
            "lpips_heads": digest(&self.lpips_heads)?,
        }))
    }
}

/// `files` describes further files that affect the result.
pub(super) fn train_on(
    run: &RunArgs,
    recipe: &AdapterRecipe,
    data: &Data<'_>,
    files: Value,
    stop: &Stop,
) -> Result<RunEnd> {
    let samples = data.train.episodes();
    let identity = [
        ("latent_space", json!(data.train.space().to_string())),
        ("data", json!(data.train.digest())),
        ("files", json!(files)),
    ];
    let settings = run.settings(recipe, samples, identity)?;
    let mut task = AdapterTask::new(recipe, settings.steps, data, run)?;
    let about = format!(
        "{samples} episodes, {} frames, {} threads",
        data.train.count(),
        run.threads()?
    );
    run.train(&mut task, recipe, &settings, (&about, stop))
}
