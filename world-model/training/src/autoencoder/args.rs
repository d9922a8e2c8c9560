use std::{path::PathBuf, time::Duration};

use clap::Args;


use super::{AutoencoderSettings, evaluate_bags, train, trainer::TrainingError};
use crate::dataset::Dataset;

/// Trains the autoencoder on bags.
#[derive(Args, Clone, Debug)]
pub struct TrainAutoencoderArgs {
    /// Folder of bags, or one bag
    #[arg(long)]
    pub data: PathBuf,
    /// Folder for the weights, the checkpoint and the loss curve; a checkpoint in it is taken up
    #[arg(long)]
    pub out: PathBuf,
    /// Folder for decoded frames [default: `cache` in the output folder]
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Folder of bags to measure on at the end
    #[arg(long)]
    pub heldout: Option<PathBuf>,
    /// Steps in all
    #[arg(long, default_value_t = AutoencoderSettings::default().steps)]
    pub steps: u64,
    /// Steps at the end that see whole pictures instead of crops
    #[arg(long, default_value_t = AutoencoderSettings::default().whole_picture_steps)]
    pub whole_picture_steps: u64,
    /// Crops a step
    #[arg(long, default_value_t = AutoencoderSettings::default().batch)]
    pub batch: usize,
    /// Highest learning rate
    #[arg(long, default_value_t = AutoencoderSettings::default().learning_rate)]
    pub learning_rate: f64,
    /// Standard deviation of the noise on the latents
    #[arg(long, default_value_t = AutoencoderSettings::default().latent_noise)]
    pub latent_noise: f32,
    /// Weight of the mean square of the latents
    #[arg(long, default_value_t = AutoencoderSettings::default().latent_penalty)]
    pub latent_penalty: f32,
    /// Weight of pixels inside masks, added to 1
    #[arg(long, default_value_t = AutoencoderSettings::default().mask_weight)]
    pub mask_weight: f32,
    /// Channels of the latents
    #[arg(long, default_value_t = AutoencoderSettings::default().model.latent_channels)]
    pub latent_channels: usize,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Seconds between two checkpoints
    #[arg(long, default_value_t = 180)]
    pub checkpoint_seconds: u64,
}

impl TrainAutoencoderArgs {
    /// Trains, and measures if held-out bags are given.
    ///
    /// # Errors
    /// When the data, the settings or a file cannot be used.
    pub fn run(&self) -> Result<(), TrainingError> {
        let mut settings = AutoencoderSettings {
            seed: self.seed,
            steps: self.steps,
            whole_picture_steps: self.whole_picture_steps,
            batch: self.batch,
            mask_weight: self.mask_weight,
            latent_penalty: self.latent_penalty,
            latent_noise: self.latent_noise,
            learning_rate: self.learning_rate,
            ..AutoencoderSettings::default()
        };
        settings.model.latent_channels = self.latent_channels;
        let cache = self.cache.clone().unwrap_or_else(|| self.out.join("cache"));
        let size = (settings.model.height, settings.model.width);
        let dataset = Dataset::open(&self.data, &cache, size)?;
        tracing::info!(
            "{} episodes, {} frames of {}x{}",
            dataset.episodes().len(),
            dataset.frame_count(),
            size.0,
            size.1
        );
        let every = Duration::from_secs(self.checkpoint_seconds);
        let autoencoder = train(&dataset, settings, &self.out, every)?;
        tracing::info!("latent space {}", autoencoder.space());
        if let Some(heldout) = &self.heldout {
            let reconstruction = evaluate_bags(&autoencoder, heldout, &cache, 2000)?;
            tracing::info!("held-out bags, {reconstruction}");
        }
        Ok(())
    }
}
