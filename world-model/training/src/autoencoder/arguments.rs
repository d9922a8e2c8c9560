use std::{path::PathBuf, time::Duration};

use clap::Args;
use wm_model::{Autoencoder, Encoder as _};

use super::{AutoencoderSettings, evaluate, picture, train, trainer::TrainingError};
use crate::dataset::Dataset;

/// Trains the autoencoder on bags of episodes.
#[derive(Args, Clone, Debug)]
pub struct TrainAutoencoderArgs {
    /// Folder with the bags of the episodes. If they have masks, pixels inside the masks get more weight.
    #[arg(long)]
    pub bags: PathBuf,
    /// Folder with held-out bags, for evaluation.
    #[arg(long)]
    pub held_out: Option<PathBuf>,
    /// Folder for checkpoint, loss curve and weights. An interrupted training resumes from here.
    #[arg(long)]
    pub out: PathBuf,
    /// Folder for decoded frames; `cache` in the output folder by default.
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Optimiser steps.
    #[arg(long, default_value_t = AutoencoderSettings::default().steps)]
    pub steps: u64,
    /// Number of final steps that use whole pictures instead of crops.
    #[arg(long, default_value_t = AutoencoderSettings::default().whole_picture_steps)]
    pub whole_picture_steps: u64,
    /// Crops per step.
    #[arg(long, default_value_t = AutoencoderSettings::default().batch)]
    pub batch: usize,
    /// Highest learning rate.
    #[arg(long, default_value_t = AutoencoderSettings::default().learning_rate)]
    pub learning_rate: f64,
    /// Fraction of the crops that are centred on something that moves.
    #[arg(long, default_value_t = AutoencoderSettings::default().salient)]
    pub salient: f64,
    /// Weight of pixels inside masks, added to 1.
    #[arg(long, default_value_t = AutoencoderSettings::default().mask_weight)]
    pub mask_weight: f32,
    /// Standard deviation of the noise on the latents.
    #[arg(long, default_value_t = AutoencoderSettings::default().latent_noise)]
    pub latent_noise: f32,
    /// Weight of the mean square of the latents.
    #[arg(long, default_value_t = AutoencoderSettings::default().latent_penalty)]
    pub latent_penalty: f32,
    /// Channels of the latents.
    #[arg(long, default_value_t = AutoencoderSettings::default().model.latent_channels)]
    pub latent_channels: usize,
    /// Seed of weights, crops and noise.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Seconds between checkpoints.
    #[arg(long, default_value_t = 180)]
    pub checkpoint_seconds: u64,
}

impl TrainAutoencoderArgs {
    /// The settings that these arguments ask for.
    #[must_use]
    pub fn settings(&self) -> AutoencoderSettings {
        let mut settings = AutoencoderSettings {
            seed: self.seed,
            steps: self.steps,
            whole_picture_steps: self.whole_picture_steps,
            batch: self.batch,
            salient: self.salient,
            mask_weight: self.mask_weight,
            latent_penalty: self.latent_penalty,
            latent_noise: self.latent_noise,
            learning_rate: self.learning_rate,
            ..AutoencoderSettings::default()
        };
        settings.model.latent_channels = self.latent_channels;
        settings
    }

    /// Trains, and evaluates if held-out bags are given.
    ///
    /// # Errors
    /// When the data, the settings or a file cannot be used.
    pub fn run(&self) -> Result<(), TrainingError> {
        let settings = self.settings();
        let cache = self.cache.clone().unwrap_or_else(|| self.out.join("cache"));
        let size = (settings.model.height, settings.model.width);
        let dataset = Dataset::open(&self.bags, &cache, size)?;
        tracing::info!(
            "{} episodes, {} frames of {}x{}",
            dataset.episodes().len(),
            dataset.frame_count(),
            size.0,
            size.1
        );
        let every = Duration::from_secs(self.checkpoint_seconds);
        let autoencoder = train(&dataset, settings, &self.out, every)?;
        println!("latent space {}", autoencoder.space());
        if let Some(held_out) = &self.held_out {
            let dataset = Dataset::open(held_out, &cache, size)?;
            println!("held-out bags, {}", evaluate(&autoencoder, &dataset, 1000)?);
        }
        Ok(())
    }
}

/// Measures how well an autoencoder reconstructs the frames of held-out bags.
#[derive(Args, Clone, Debug)]
pub struct EvaluateAutoencoderArgs {
    /// Folder with the bags of the episodes.
    #[arg(long)]
    pub bags: PathBuf,
    /// Weights: a file, or a folder with `autoencoder.safetensors` or with the two published TAEF2 files.
    #[arg(long)]
    pub autoencoder: PathBuf,
    /// Folder for decoded frames.
    #[arg(long)]
    pub cache: PathBuf,
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
    pub fn run(&self) -> Result<(), TrainingError> {
        let autoencoder = Autoencoder::open(&self.autoencoder)?;
        let dataset = Dataset::open(&self.bags, &self.cache, autoencoder.input_size())?;
        println!("{}", evaluate(&autoencoder, &dataset, self.frames)?);
        if let Some(path) = &self.picture {
            let picture = picture(&autoencoder, &dataset, 8)?;
            picture.save(path).map_err(|error| TrainingError::Io {
                path: path.clone(),
                source: std::io::Error::other(error),
            })?;
        }
        Ok(())
    }
}
