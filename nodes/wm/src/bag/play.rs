//! `wm bag play`, with the options of `ros2 bag play`.

use super::parameters::Parameters;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_nodes::player;
use wm_ros::NodeArgs;

/// Plays a bag.
#[derive(Args, Debug)]
pub struct PlayCommand {
    /// The bag's folder, or one .mcap file
    bag: PathBuf,
    /// Seconds of the bag in a second
    #[arg(short, long, default_value_t = 1.0)]
    rate: f64,
    /// Begin again at the end
    #[arg(short, long = "loop")]
    is_looping: bool,
    /// Publish the bag's time on /clock, so often a second
    #[arg(long, value_name = "HZ", num_args = 0..=1, default_missing_value = "40")]
    clock: Option<f64>,
    /// Play under other names
    #[arg(short = 'm', long, value_name = "FROM:=TO", num_args = 1.., value_parser = parse_rule)]
    remap: Vec<String>,
    /// Wait before the first message, in seconds
    #[arg(short, long, value_name = "SECONDS", default_value_t = 0.0)]
    delay: f64,
    /// Leave out so much of the beginning, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    start_offset: f64,
    /// Play these topics only
    #[arg(long, num_args = 1..)]
    topics: Vec<String>,
    /// Do not play these topics
    #[arg(long, num_args = 1..)]
    exclude_topics: Vec<String>,
    /// Move header stamps from the bag's time to now
    #[arg(long, conflicts_with = "clock")]
    restamp: bool,
    /// Do not begin before these topics have a publisher and a subscriber
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    wait_for: Vec<String>,
    /// The longest to wait for them, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
    wait_timeout: f64,
    /// Publish so many coming actions at each action, on /wm/action_chunk
    #[arg(long, value_name = "N", default_value_t = 0)]
    action_chunk_length: u16,
    /// Publish the bag's last frame as goal, on /wm/goal/image/compressed
    #[arg(long)]
    goal: bool,
}

fn parse_rule(text: &str) -> Result<String, String> {
    match text.split_once(":=") {
        Some((from, to)) if !from.is_empty() && !to.is_empty() => Ok(text.to_owned()),
        _ => Err("expected from:=to".to_owned()),
    }
}

impl PlayCommand {
    /// Runs it.
    pub fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let mut parameters = Parameters::new();
        parameters.set("bag", &self.bag)?;
        parameters.set("rate", self.rate)?;
        parameters.set("loop", self.is_looping)?;
        parameters.set("clock", self.clock.unwrap_or(0.0))?;
        parameters.set("delay", self.delay)?;
        parameters.set("start_offset", self.start_offset)?;
        parameters.set_list("topics", &self.topics)?;
        parameters.set_list("exclude_topics", &self.exclude_topics)?;
        parameters.set("restamp", self.restamp)?;
        parameters.set_list("wait_for", &self.wait_for)?;
        parameters.set("wait_timeout", self.wait_timeout)?;
        parameters.set("action_chunk_length", self.action_chunk_length)?;
        parameters.set("goal", self.goal)?;
        for rule in &self.remap {
            parameters.remap(rule);
        }
        Ok(player::run(&NodeArgs::parse(parameters.with(ros_args))?)?.into())
    }
}
