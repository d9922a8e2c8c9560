//! `wm bag recover`.

use crate::output::print;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_program::progress::Progress;
use wm_robot_nodes::ending::Ending;

/// Recovers a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "Every whole chunk is kept, also after a damaged one, with unchanged messages, times, sequence numbers,\n\
    schemas and QoS. Indexes, summary and metadata.yaml are rebuilt. Files that rosbag2 compressed are decompressed.\n\
    IN is not changed. For sqlite3, use `wm bag convert`.\n\n\
    Examples:\n  \
    wm bag recover robot_run robot_run_sound           # a recorder was killed, or its disk was full\n  \
    wm bag recover download.mcap sound                 # a copy was truncated\n\n\
    Exit codes: 0 nothing was lost, 3 something was lost (each loss is listed with its byte), 1 there is no bag to recover."
)]
pub(crate) struct RecoverCommand {
    /// Folder of the bag, or one of its files
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Folder for the new bag
    #[arg(value_name = "OUT")]
    output: PathBuf,
}

impl RecoverCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        let progress = Progress::open_ended("recovering", "messages");
        let recovery = wm_bag::recover(&self.input, &self.output)?;
        drop(progress);
        print(format_args!("{recovery}\n"))?;
        Ok(Ending::lost_if(!recovery.losses.is_empty()).into())
    }
}
