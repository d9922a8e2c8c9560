//! `wm bag`.

mod parameters;
mod play;
mod record;

use crate::output::print;
use anyhow::Result;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use wm_bag::{BagReader, BagWarning};
use wm_import::{ImportOptions, import_bridge};
use wm_nodes::ending::Ending;

/// Bags.
#[derive(Debug, Subcommand)]
pub enum BagCommand {
    /// Publish a bag's messages at their times
    Play(play::PlayCommand),
    /// Record topics into a new bag
    Record(record::RecordCommand),
    /// Show what a bag holds
    Info {
        /// The bag's folder, or one .mcap file
        bag: PathBuf,
    },
    /// Make bags of other formats' episodes
    #[command(subcommand)]
    Import(ImportCommand),
}

/// Formats that are imported.
#[derive(Debug, Subcommand)]
pub enum ImportCommand {
    /// Bridge V2: the mp4 and npz layout, or the RLDS TFRecord layout
    Bridge(BridgeCommand),
}

/// Imports Bridge V2 episodes.
#[derive(Args, Debug)]
pub struct BridgeCommand {
    /// Folder of the episodes
    source: PathBuf,
    /// Folder for the bags, one an episode
    output: PathBuf,
    /// Import at most so many episodes
    #[arg(long)]
    episodes: Option<usize>,
    /// JPEG quality of the frames, 1 to 100
    #[arg(long, default_value_t = ImportOptions::default().jpeg_quality, value_parser = clap::value_parser!(u8).range(1..=100))]
    jpeg_quality: u8,
}

impl BagCommand {
    /// Whether `--ros-args` may follow.
    pub fn takes_ros_args(&self) -> bool {
        matches!(self, Self::Play(_) | Self::Record(_))
    }

    /// Runs it.
    pub fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        match self {
            Self::Play(command) => command.run(ros_args),
            Self::Record(command) => command.run(ros_args),
            Self::Info { bag } => {
                let summary = BagReader::open(&bag)?.summary();
                print(format_args!("{summary}\n"))?;
                let is_lost = summary.warnings.iter().any(BagWarning::is_loss);
                Ok(Ending::lost_if(is_lost).into())
            }
            Self::Import(ImportCommand::Bridge(command)) => {
                let defaults = ImportOptions::default();
                let options = ImportOptions {
                    episodes: command.episodes,
                    jpeg_quality: command.jpeg_quality,
                    ..defaults
                };
                for bag in import_bridge(&command.source, &command.output, &options)? {
                    print(format_args!("{}\n", bag.display()))?;
                }
                Ok(ExitCode::SUCCESS)
            }
        }
    }
}
