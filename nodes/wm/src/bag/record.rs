//! `wm bag record`, with the options of `ros2 bag record`.

use super::parameters::Parameters;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_nodes::recorder;
use wm_ros::NodeArgs;

/// Records a bag.
#[derive(Args, Debug)]
pub struct RecordCommand {
    /// Folder of the new bag
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Topics to record
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    topics: Vec<String>,
    /// Record all topics, those that appear later too
    #[arg(short, long)]
    all: bool,
    /// Do not record these topics
    #[arg(long, num_args = 1..)]
    exclude_topics: Vec<String>,
    /// Replace a bag that is there already
    #[arg(long)]
    overwrite: bool,
}

impl RecordCommand {
    /// Runs it.
    pub fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let mut parameters = Parameters::new();
        parameters.set("output", &self.output)?;
        parameters.set("overwrite", self.overwrite)?;
        parameters.set_list("topics", &self.topics)?;
        parameters.set_list("exclude_topics", &self.exclude_topics)?;
        Ok(recorder::run(&NodeArgs::parse(parameters.with(ros_args))?)?.into())
    }
}
