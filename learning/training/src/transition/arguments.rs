use std::path::PathBuf;

use clap::Args;
use wm_dataset::HeldOutArgs;

use crate::arguments::RunArgs;

/// Trains the transition model on bags of episodes, with the latents of a frozen encoder.
#[derive(Clone, Debug, Args)]
pub struct TrainTransitionArgs {
    /// What every training has.
    #[command(flatten)]
    pub run: RunArgs,
    /// The model whose frozen encoder makes the latents: tiny, or a model's folder.
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: String,
}

/// Evaluates a trained transition model on held-out bags.
#[derive(Clone, Debug, Args)]
pub struct EvaluateTransitionArgs {
    /// What to measure on.
    #[command(flatten)]
    pub on: HeldOutArgs,
    /// The model whose frozen encoder makes the latents: tiny, or a model's folder.
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: String,
    /// Weights of the transition model.
    #[arg(long)]
    pub weights: PathBuf,
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
