//! `wm train`.

use anyhow::Result;
use clap::Subcommand;
use std::process::ExitCode;
use wm_training::{autoencoder::TrainAutoencoderArgs, transition::TrainTransitionArgs};

/// Trains a model.
#[derive(Debug, Subcommand)]
pub enum TrainCommand {
    /// Train the autoencoder: frames to latents and back
    Autoencoder(TrainAutoencoderArgs),
    /// Train the transition model on the latents of a frozen encoder
    Transition(TrainTransitionArgs),
}

impl TrainCommand {
    /// Runs it.
    pub fn run(self) -> Result<ExitCode> {
        match self {
            Self::Autoencoder(arguments) => arguments.run()?,
            Self::Transition(arguments) => arguments.run()?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
