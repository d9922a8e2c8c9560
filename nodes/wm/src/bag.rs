//! `wm bag`.

mod cut;
mod parameters;
mod play;
mod record;
mod recover;
mod time;
mod topic_options;

use crate::{external, output::print};
use anyhow::Result;
use clap::{Args, Subcommand};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wm_bag::{BagReader, BagWarning};
use wm_import::{ImportError, ImportOptions, import_bridge, import_droid};
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
    /// Make a sound bag of one that is cut off or damaged
    Recover(recover::RecoverCommand),
    /// Write a part of a bag: a time, some topics
    Cut(cut::CutCommand),
    /// Make bags of other formats' episodes
    #[command(subcommand)]
    Import(ImportCommand),
    /// Make other formats' data sets of bags
    #[command(subcommand)]
    Export(ExportCommand),
}

/// Formats that are imported.
#[derive(Debug, Subcommand)]
pub enum ImportCommand {
    /// Bridge V2: the mp4 and npz layout, or the RLDS TFRecord layout
    Bridge(EpisodesCommand),
    /// DROID: annotation/SPLIT/NAME.json with three videos an episode
    Droid(EpisodesCommand),
    /// LeRobot datasets, v2.1 and v3.0; by the program wm-lerobot
    #[command(disable_help_flag = true)]
    Lerobot(ForeignCommand),
}

/// Formats that are exported.
#[derive(Debug, Subcommand)]
pub enum ExportCommand {
    /// LeRobot datasets, v3.0; by the program wm-lerobot
    #[command(disable_help_flag = true)]
    Lerobot(ForeignCommand),
}

/// What a program of its own is called with.
#[derive(Args, Debug)]
pub struct ForeignCommand {
    /// As `wm-lerobot import|export --help` says
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

impl ForeignCommand {
    fn run(self, command: &str) -> Result<ExitCode> {
        let command = OsString::from(command);
        external::exec("wm-lerobot", [command].into_iter().chain(self.arguments))
    }
}

/// Imports episodes of a data set.
#[derive(Args, Debug)]
pub struct EpisodesCommand {
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
            Self::Recover(command) => command.run(),
            Self::Cut(command) => command.run(),
            Self::Import(ImportCommand::Bridge(command)) => command.run(import_bridge),
            Self::Import(ImportCommand::Droid(command)) => command.run(import_droid),
            Self::Import(ImportCommand::Lerobot(command)) => command.run("import"),
            Self::Export(ExportCommand::Lerobot(command)) => command.run("export"),
        }
    }
}

impl EpisodesCommand {
    fn run(
        self,
        import: fn(&Path, &Path, &ImportOptions) -> Result<Vec<PathBuf>, ImportError>,
    ) -> Result<ExitCode> {
        let options = ImportOptions {
            episodes: self.episodes,
            jpeg_quality: self.jpeg_quality,
            ..ImportOptions::default()
        };
        for bag in import(&self.source, &self.output, &options)? {
            print(format_args!("{}\n", bag.display()))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}
