//! The audit for `wm bag info --audit`, which needs this program's decoder for bags with video.

use std::{io::Write as _, path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::Args;
use wm_audit::{Topics, audit_bag};
use wm_bag::BagReader;
use wm_program::progress::Progress;

/// Audits a bag.
#[derive(Args, Debug)]
pub struct AuditCommand {
    /// Folder of the bag, or one of its files
    bag: PathBuf,
    /// Topic of a camera to examine; the first one is compared with actions (repeatable)
    #[arg(long = "camera", value_name = "TOPIC")]
    cameras: Vec<String>,
    /// Topic of the actions
    #[arg(long, value_name = "TOPIC")]
    action: Option<String>,
    /// Print the audit as JSON
    #[arg(long)]
    json: bool,
}

impl AuditCommand {
    /// Prints the audit. Findings do not change the exit code.
    pub fn run(self) -> Result<ExitCode> {
        let reader = BagReader::open(&self.bag)?;
        let topics = Topics {
            cameras: self.cameras,
            actions: self.action,
        };
        let progress = Progress::open_ended("examining", "messages");
        let audit = audit_bag(&reader, &topics, || progress.inc(1));
        drop(progress);
        let mut out = std::io::stdout().lock();
        match self.json {
            true => writeln!(out, "{:#}", serde_json::to_value(&audit)?)?,
            false => writeln!(out, "\n{audit}")?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
