use anyhow::Result;
use clap::Args;
use wm_dataset::{Dataset, HeldOutArgs, Latents};
use wm_zoo::ModelFolder;

use super::{EncodedData, RunArgs};
use crate::model_folder::carry_encoder;

/// A training on the latents of a frozen encoder.
#[derive(Clone, Debug, Args)]
pub struct LatentRunArgs {
    /// Options of every training.
    #[command(flatten)]
    pub run: RunArgs,
    /// Model whose frozen encoder makes the latents: tiny, or a model's folder
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: String,
}

impl LatentRunArgs {
    /// Opens the model of the encoder and the data with their latents, and makes the output folder a model that encodes
    /// so.
    ///
    /// # Errors
    /// If model or data are unusable, or a file cannot be written.
    pub fn open(&self) -> Result<(ModelFolder, EncodedData)> {
        let folder = ModelFolder::open(&self.encoder)?;
        let on = self.run.encoded(&*folder.encoder()?)?;
        carry_encoder(&self.encoder, &self.run.out)?;
        Ok((folder, on))
    }
}

/// Data for an evaluation, with the frozen encoder of their latents.
#[derive(Clone, Debug, Args)]
pub struct HeldOutLatentArgs {
    /// Evaluation data.
    #[command(flatten)]
    pub on: HeldOutArgs,
    /// Model whose frozen encoder makes the latents: tiny, or a model's folder
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: String,
}

impl HeldOutLatentArgs {
    /// Opens the model of the encoder, and the data with their latents.
    ///
    /// # Errors
    /// If model or data are unusable.
    pub fn open(&self) -> Result<(ModelFolder, Dataset, Latents)> {
        let folder = ModelFolder::open(&self.encoder)?;
        let encoder = folder.encoder()?;
        let dataset = self.on.open(encoder.framing())?;
        let latents = Latents::open(&dataset, &*encoder, &self.on.cache())?;
        Ok((folder, dataset, latents))
    }
}
