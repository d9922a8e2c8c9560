//! `wm report`.

use crate::output::print;
use anyhow::{Result, ensure};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_program::progress::Progress;
use wm_robot_nodes::ending::Ending;
use wm_view::report::{score_bag, terminal_table, write_report};

/// Scores a recorded bag.
#[derive(Args, Debug)]
pub(crate) struct ReportCommand {
    /// Bag with camera frames and predictions: its folder, or a single .mcap file
    bag: PathBuf,
    /// Folder for report.json, report.md and strip.png
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

impl ReportCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        let progress = Progress::open_ended("scoring", "messages");
        let (scorer, unreadable) = score_bag(&self.bag)?;
        drop(progress);
        let (report, files) = write_report(&scorer, &self.bag.display().to_string(), &self.output)?;
        print(terminal_table(&report))?;
        for file in files {
            print(format_args!("{}\n", file.display()))?;
        }
        for (topic, (count, reason)) in &unreadable {
            eprintln!("wm: {topic}: {count} message(s) skipped, the first because: {reason}");
        }
        ensure!(
            report.frames > 0,
            "no frame of the bag's camera could be read, so nothing was compared"
        );
        ensure!(
            !scorer.is_without_predictions(),
            "no prediction of the bag could be read, although {}",
            report.frames_in_words()
        );
        Ok(Ending::lost_if(!unreadable.is_empty()).into())
    }
}
