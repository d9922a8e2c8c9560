//! `wm eval paper`.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use wm_metrics::findings::Suite;

use crate::SuiteArgs;

/// Name of the page in the output folder.
const PAGE: &str = "paper.md";

/// Fill the paper's tables and figures with the values of models on bags
#[derive(Clone, Debug, Args)]
pub struct PaperArgs {
    /// Folder for the page (paper.md), the report, the figures, and the records from which an interrupted run resumes
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The measurement.
    #[command(flatten)]
    pub suites: SuiteArgs,
}

impl PaperArgs {
    /// Measures all suites, and writes the report and the page.
    ///
    /// # Errors
    /// Those of [`SuiteArgs::run`].
    pub fn run(self) -> Result<()> {
        let Self { out, mut suites } = self;
        ensure!(
            suites.output.report.is_none() && suites.output.paper.is_none(),
            "--out has the report and the page: leave --report and --paper out"
        );
        // As in the paper, whatever the extent.
        suites.searches_all = true;
        if !suites.shard.is_some_and(|shard| shard.is_part()) {
            suites.output.paper = Some(out.join(PAGE));
            suites.output.report = Some(out);
        }
        suites.run(&Suite::ALL)
    }
}
