//! `wm eval`.

use anyhow::Result;
use clap::Subcommand;
use std::process::ExitCode;
use wm_training::{autoencoder::EvaluateAutoencoderArgs, transition::EvaluateTransitionArgs};

/// Measures a model on bags that it was not trained on.
#[derive(Debug, Subcommand)]
pub enum EvalCommand {
    /// What an autoencoder makes of the frames
    Autoencoder(EvaluateAutoencoderArgs),
    /// A transition model's predictions against persistence, and plans made with it
    Transition(EvaluateTransitionArgs),
}

impl EvalCommand {
    /// Runs it.
    pub fn run(self) -> Result<ExitCode> {
        match self {
            Self::Autoencoder(arguments) => arguments.run()?,
            Self::Transition(arguments) => arguments.run()?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
