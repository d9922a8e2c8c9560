use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use wm_model::{
    autoencoder::Autoencoder,
    sampler::Sampler,
    transition::{ActionAlignment, Parametrisation, TransitionConfig},
};

use super::Objective;
use crate::latents::Latents;

/// How noise levels are drawn, before the time shift.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TauDistribution {
    /// Uniform over 0..1.
    Uniform,
    /// The logistic function of a standard normal variable.
    LogitNormal,
}

/// Trains the transition model on bags of episodes, with the latents of a frozen encoder.
#[derive(Clone, Debug, Args)]
pub struct TrainTransitionArgs {
    /// Folder with the bags of the episodes.
    #[arg(long)]
    pub bags: PathBuf,
    /// Folder with held-out bags, for evaluation.
    #[arg(long)]
    pub held_out: Option<PathBuf>,
    /// Weights of the autoencoder that encodes the frames to latents.
    #[arg(long)]
    pub autoencoder: PathBuf,
    /// Folder for checkpoint, loss curve and weights. An interrupted training resumes from here.
    #[arg(long)]
    pub out: PathBuf,
    /// Folder for decoded frames and latents; `cache` in the output folder by default.
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Preset: tiny, dit-s, dit-b or dit-l.
    #[arg(long, default_value = "tiny")]
    pub preset: String,
    /// Width instead of the preset's.
    #[arg(long)]
    pub hidden: Option<usize>,
    /// Depth instead of the preset's.
    #[arg(long)]
    pub depth: Option<usize>,
    /// Attention heads instead of the preset's.
    #[arg(long)]
    pub heads: Option<usize>,
    /// Frames in a clip and in the model's context window.
    #[arg(long, default_value_t = 10)]
    pub frames: usize,
    /// Patch size: side of a patch of the latent.
    #[arg(long, default_value_t = 2)]
    pub patch: usize,
    /// Predict the velocity, as the published checkpoints and their presets do, instead of the change from the last
    /// frame.
    #[arg(long)]
    pub velocity: bool,
    /// Pair an action with the frame that it starts from, as the published checkpoints and their presets do, instead of
    /// the frame that it leads to.
    #[arg(long)]
    pub action_with_frame: bool,
    /// Number of Euler steps that the weights file recommends, instead of the preset's.
    #[arg(long)]
    pub sampling_steps: Option<usize>,
    /// Optimiser steps.
    #[arg(long, default_value_t = 1400)]
    pub steps: u64,
    /// Clips per step.
    #[arg(long, default_value_t = 8)]
    pub batch: usize,
    /// Clips that one thread computes at once.
    #[arg(long, default_value_t = 2)]
    pub micro_batch: usize,
    /// Highest learning rate.
    #[arg(long, default_value_t = 2e-3)]
    pub learning_rate: f64,
    /// Warm-up steps, over which the learning rate rises.
    #[arg(long, default_value_t = 60)]
    pub warm_up: u64,
    /// Final learning rate, as a fraction of the highest.
    #[arg(long, default_value_t = 0.02)]
    pub final_rate: f64,
    /// Decay of the moving average of the weights.
    #[arg(long, default_value_t = 0.99)]
    pub ema_decay: f64,
    /// Distribution of the noise levels.
    #[arg(long, value_enum, default_value_t = TauDistribution::Uniform)]
    pub tau: TauDistribution,
    /// Time shift, instead of the preset's. It applies to the noise levels in training and in sampling, and is written
    /// to the weights file.
    #[arg(long)]
    pub shift: Option<f64>,
    /// Standard deviation of the noise level of history frames.
    #[arg(long, default_value_t = 0.15)]
    pub history_noise: f64,
    /// Fraction of the clips whose history has the model's own predictions in place of the later frames.
    #[arg(long, default_value_t = 0.0)]
    pub own_history: f64,
    /// Fraction of the clips with no action (the null action: zeros, the last value 1).
    #[arg(long, default_value_t = 0.0)]
    pub action_dropout: f64,
    /// Number of threads; all of the machine by default.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Seed of weights, clips and noise.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Steps between checkpoints.
    #[arg(long, default_value_t = 350)]
    pub save_every: u64,
}

impl TrainTransitionArgs {
    pub(super) fn encoder(&self) -> Result<Autoencoder> {
        Ok(Autoencoder::open(&self.autoencoder)?)
    }

    pub(super) fn cache_dir(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(|| self.out.join("cache"))
    }

    pub(super) fn threads(&self) -> Result<usize> {
        match self.threads {
            Some(threads) => Ok(threads),
            None => Ok(std::thread::available_parallelism()
                .context("how many threads there are")?
                .get()),
        }
    }

    pub(super) fn config(&self, latents: &Latents) -> Result<TransitionConfig> {
        let action_dim = if self.action_dropout > 0.0 { 10 } else { 7 };
        let latent = latents.space().shape();
        let preset = TransitionConfig::preset(&self.preset, latent, self.patch, action_dim)?;
        let config = TransitionConfig {
            hidden: self.hidden.unwrap_or(preset.hidden),
            depth: self.depth.unwrap_or(preset.depth),
            heads: self.heads.unwrap_or(preset.heads),
            max_frames: self.frames,
            parametrisation: if self.velocity {
                Parametrisation::Velocity
            } else {
                preset.parametrisation
            },
            action_alignment: if self.action_with_frame {
                ActionAlignment::WithFrame
            } else {
                preset.action_alignment
            },
            sampler: Sampler {
                steps: self.sampling_steps.unwrap_or(preset.sampler.steps),
                shift: self.shift.unwrap_or(preset.sampler.shift),
                ..preset.sampler
            },
            ..preset
        };
        config.validate()?;
        Ok(config)
    }

    /// The objective of a model of `config`, which is trained at the time shift that it is sampled with.
    pub(super) fn objective(&self, config: &TransitionConfig) -> Result<Objective> {
        let objective = Objective {
            clips: self.batch,
            micro_batch: self.micro_batch,
            history: 2,
            tau: self.tau,
            shift: config.sampler.shift,
            history_noise: self.history_noise,
            own_history: self.own_history,
            action_dropout: self.action_dropout,
            seed: self.seed,
        };
        objective.validate()?;
        Ok(objective)
    }
}

/// Evaluates a trained transition model on held-out bags.
#[derive(Clone, Debug, Args)]
pub struct EvaluateTransitionArgs {
    /// Folder with the bags of the episodes.
    #[arg(long)]
    pub bags: PathBuf,
    /// Weights of the autoencoder.
    #[arg(long)]
    pub autoencoder: PathBuf,
    /// Weights of the transition model.
    #[arg(long)]
    pub weights: PathBuf,
    /// Folder for decoded frames and latents.
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Maximum number of windows to evaluate.
    #[arg(long, default_value_t = usize::MAX)]
    pub windows: usize,
    /// Other numbers of Euler steps to evaluate.
    #[arg(long, value_delimiter = ',')]
    pub sampling_steps: Vec<usize>,
    /// Number of one-step plans from zero, to measure how well they recover the true action.
    #[arg(long, default_value_t = 24)]
    pub plans: usize,
}

impl EvaluateTransitionArgs {
    pub(super) fn cache_dir(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(std::env::temp_dir)
    }
}
