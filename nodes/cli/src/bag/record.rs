//! `wm bag record`, with the options of `ros2 bag record`.

use crate::{
    parameter_flags::{Flagged, ParameterFlags},
    parameters::Parameters,
};
use anyhow::Result;
use clap::{Arg, Args};
use std::process::ExitCode;
use wm_robot_nodes::recorder;
use wm_ros::{NodeArgs, ParameterSpec};

/// Records a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "At the end it reports which messages are missing from the bag, by topic and cause: dropped because a queue\n\
    was full, not decodable, or missing in their publishers' sequence numbers (best effort too; messages sent\n\
    before the first or after the last received one cannot be detected).\n\n\
    Space pauses and resumes in a terminal. Services (rosbag2_interfaces): ~/pause ~/resume ~/is_paused\n\
    ~/split_bagfile ~/stop ~/record and, in snapshot mode, ~/snapshot. The node is /wm/recorder.\n\n\
    Examples:\n  \
    wm bag record -a -o run\n  \
    wm bag record -e '^/camera/' --topic-types wm_msgs/msg/Action -o run\n  \
    wm bag record -a -o last --snapshot-mode --max-cache-size 100000000\n  \
    wm bag record /camera/image_raw/compressed /wm/action -o run\n  \
    wm bag record -a -o run --max-bag-duration 60 --compression-format lz4\n  \
    wm bag record -a -o run --max-bag-size 1000000000 --storage-preset-profile fastwrite\n\n\
    Exit codes: 0 everything is in the bag, 3 something was lost, 1 failed."
)]
pub(crate) struct RecordCommand {
    /// Topics to record; the same as --topics
    #[arg(value_name = "TOPIC")]
    names: Vec<String>,
    /// Record all topics that are not hidden, including those that appear later
    #[arg(short, long, visible_alias = "all-topics", conflicts_with_all = ["names", "topics", "regex", "topic_types"])]
    all: bool,
    #[command(flatten)]
    flags: ParameterFlags<Recorder>,
    /// Take log times from /clock; nothing is recorded before its first message
    #[arg(long)]
    use_sim_time: bool,
    /// Log level: debug, info, warn, error or fatal
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
    /// What to compress. Only chunks of the file can be compressed (see --compression-format), as MCAP defines it.
    /// rosbag2's modes file and message are refused, because other MCAP readers cannot read such messages
    #[arg(long, value_name = "MODE", value_parser = parse_compression_mode)]
    compression_mode: Option<String>,
}

/// The recorder's parameters as flags, named as in `ros2 bag record` if it has them.
struct Recorder;

impl Flagged for Recorder {
    fn specs() -> Vec<ParameterSpec> {
        (recorder::NODE.parameters)()
    }

    fn flag(name: &str, flag: Arg) -> Option<Arg> {
        Some(match name {
            "output" => flag.short('o').required(true),
            "regex" => flag.short('e'),
            "exclude_regex" => flag.short('x'),
            "max_bag_size" => flag.short('b'),
            "max_bag_duration" => flag.short('d'),
            _ => flag,
        })
    }
}

fn parse_compression_mode(text: &str) -> Result<String, String> {
    match text.to_lowercase().as_str() {
        mode @ "none" => Ok(mode.to_owned()),
        "file" | "message" => Err(format!(
            "rosbag2's compression mode {text} is not supported; compress chunks instead, with --compression-format \
             none|zstd|lz4"
        )),
        _ => Err("expected none".to_owned()),
    }
}

impl RecordCommand {
    pub(crate) fn run(mut self, ros_args: Vec<String>) -> Result<ExitCode> {
        self.flags.extend("topics", self.names);
        let is_named = ["topics", "regex", "topic_types"]
            .iter()
            .any(|name| self.flags.has(name));
        if !self.all && !is_named {
            let problem =
                "nothing to record: name topics, or give --all, --regex or --topic-types\n";
            clap::Error::raw(clap::error::ErrorKind::MissingRequiredArgument, problem).exit();
        }
        let mut parameters = Parameters::new();
        self.flags.parameters(&mut parameters)?;
        parameters.set("use_sim_time", self.use_sim_time)?;
        parameters.log_level(self.log_level);
        (recorder::NODE.run)(&NodeArgs::parse(parameters.with(ros_args))?)
    }
}
