//! `wm bag recover`.

use crate::output::print;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_bag_nodes::ending::Ending;

/// Recovers a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "Every chunk that is whole is kept, also behind a damaged one, with messages, times, sequence numbers,\n\
    schemas and QoS as they were; indexes, summary and metadata.yaml are made anew. IN stays as it is.\n\n\
    Examples:\n  \
    wm bag recover robot_run robot_run_sound           # a recorder was killed, or its disk was full\n  \
    wm bag recover download.mcap sound                 # a copy was cut short\n\n\
    Exit codes: 0 nothing of the files was lost, 3 something was (it is listed by byte), 1 there is no bag to recover."
)]
pub struct RecoverCommand {
    /// The bag's folder, or one .mcap file
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Folder of the new bag
    #[arg(value_name = "OUT")]
    output: PathBuf,
}

impl RecoverCommand {
    /// Runs it.
    pub fn run(self) -> Result<ExitCode> {
        let recovery = wm_bag::recover(&self.input, &self.output)?;
        print(format_args!("{recovery}\n"))?;
        Ok(Ending::lost_if(!recovery.losses.is_empty()).into())
    }
}
