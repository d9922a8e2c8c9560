use std::path::PathBuf;

use clap::Args;

use crate::arguments::{HeldOutLatentArgs, LatentRunArgs};

/// Train the transition model on bags, with the latents of a frozen encoder
#[derive(Clone, Debug, Args)]
pub struct TrainTransitionArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: LatentRunArgs,
}

/// Evaluate a trained transition model on held-out bags
#[derive(Clone, Debug, Args)]
pub struct EvaluateTransitionArgs {
    /// Evaluation data.
    #[command(flatten)]
    pub on: HeldOutLatentArgs,
    /// Weights of the transition model
    #[arg(long)]
    pub weights: PathBuf,
    /// Most windows
    #[arg(long, default_value_t = usize::MAX)]
    pub windows: usize,
    /// Other numbers of Euler steps
    #[arg(long, value_delimiter = ',')]
    pub sampling_steps: Vec<usize>,
    /// Number of one-step plans from zero, for the recovery of true actions
    #[arg(long, default_value_t = 24)]
    pub plans: usize,
}
