//! `wm model`: the model library from the command line.

mod average;
mod check;
mod convert;
mod fetch;
mod forward;
mod info;
mod rollout;
mod running;

use crate::external;
use anyhow::Result;
use clap::Subcommand;
use std::process::ExitCode;

/// The model library.
#[derive(Debug, Subcommand)]
pub(crate) enum ModelCommand {
    /// List the parts of a model; or count parameters and operations of the paper's systems
    Info(info::InfoCommand),
    /// Load a model as the nodes do, run it once, and report its properties or its faults
    Check(check::CheckCommand),
    /// Calibrate a model's int8 input ranges on bags (runs wm-training)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Calibrate(external::Arguments),
    /// Run a model on the tensors in a file
    Forward(forward::ForwardCommand),
    /// Predict frames with a transition model
    Rollout(rollout::RolloutCommand),
    /// Average the weights of a transition model and of one that was fine-tuned from it
    Average(average::AverageCommand),
    /// Write a torch checkpoint as safetensors
    Convert(convert::ConvertCommand),
    /// Download a published model
    Fetch(fetch::FetchCommand),
}

impl ModelCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        match self {
            Self::Info(command) => command.run()?,
            Self::Check(command) => command.run()?,
            Self::Calibrate(own) => {
                return own.exec("wm-training", ["model", "calibrate"], Vec::new());
            }
            Self::Forward(command) => command.run()?,
            Self::Rollout(command) => command.run()?,
            Self::Average(command) => command.run()?,
            Self::Convert(command) => command.run()?,
            Self::Fetch(command) => command.run()?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
