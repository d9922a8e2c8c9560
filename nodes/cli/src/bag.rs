//! `wm bag`.

mod convert;
mod cut;
mod info;
mod output;
mod play;
mod record;
mod recover;
mod time;
mod topic_options;

use crate::external;
use anyhow::Result;
use clap::Subcommand;
use std::process::ExitCode;

/// Bags.
#[derive(Debug, Subcommand)]
pub(crate) enum BagCommand {
    /// Publish the messages of a bag with their recorded timing
    Play(play::PlayCommand),
    /// Record topics into a new bag
    Record(record::RecordCommand),
    /// Show the contents of a bag
    Info(info::InfoCommand),
    /// Repair a truncated or damaged bag
    Recover(recover::RecoverCommand),
    /// Write part of a bag, selected by time and topics
    Cut(cut::CutCommand),
    /// Convert a bag to MCAP: sqlite3, compressed files and messages; video to pictures (runs wm-datasets)
    Convert(convert::ConvertCommand),
    /// Convert a data set to bags: Bridge V2, DROID, LeRobot (runs wm-datasets)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Import(external::Arguments),
    /// Convert bags to a data set: LeRobot (runs wm-datasets)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Export(external::Arguments),
}

impl BagCommand {
    /// Whether `--ros-args` may follow.
    pub(crate) fn takes_ros_args(&self) -> bool {
        matches!(self, Self::Play(_) | Self::Record(_))
    }

    pub(crate) fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        match self {
            Self::Play(command) => command.run(ros_args),
            Self::Record(command) => command.run(ros_args),
            Self::Info(command) => command.run(),
            Self::Recover(command) => command.run(),
            Self::Cut(command) => command.run(),
            Self::Convert(command) => command.run(),
            Self::Import(own) => own.exec("wm-datasets", ["import"], Vec::new()),
            Self::Export(own) => own.exec("wm-datasets", ["export"], Vec::new()),
        }
    }
}
