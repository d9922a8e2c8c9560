//! `wm bag play`, with the options of `ros2 bag play`.

use super::time::parse_stamp_ns;
use crate::{
    parameter_flags::{Flagged, ParameterFlags},
    parameters::Parameters,
};
use anyhow::Result;
use clap::{Arg, Args};
use std::path::PathBuf;
use std::process::ExitCode;
use wm_robot_nodes::player;
use wm_ros::{NodeArgs, ParameterSpec};

/// Plays a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "Keys in a terminal: space pauses and resumes, cursor right plays the next message of a paused playback,\n\
    up and down change the rate by 0.1.\n\n\
    Services (rosbag2_interfaces): ~/pause ~/resume ~/toggle_paused ~/is_paused ~/get_rate ~/set_rate ~/play_next\n\
    ~/burst ~/seek ~/play ~/stop. The node is /wm/player.\n\n\
    With --start-offset, and after ~/seek, the latched messages that hold at that time are published first. A gap\n\
    without messages that is longer than --max-gap is skipped, and reported.\n\n\
    Examples:\n  \
    wm bag play run --clock --rate 0.5 --start-offset 10 --playback-duration 5\n  \
    wm bag play run -e '^/camera/' -x '/compressedDepth$' -m /camera/image_raw:=/front\n  \
    ros2 service call /wm/player/pause rosbag2_interfaces/srv/Pause\n\n\
    Exit codes: 0 everything was played, 3 something was lost or unreadable, 1 failed."
)]
pub(crate) struct PlayCommand {
    /// Folder of the bag, or one of its files
    bag: PathBuf,
    #[command(flatten)]
    flags: ParameterFlags<Player>,
    /// Remap topics
    #[arg(short = 'm', long, value_name = "FROM:=TO", num_args = 1.., value_parser = parse_rule)]
    remap: Vec<String>,
    /// Play messages up to this log time. If a duration is also given, the later of the two ends applies. STAMP is
    /// seconds since 1970 (1700000000.25) or a date (2023-11-14T22:13:20.25Z)
    #[arg(long, value_name = "STAMP", value_parser = parse_stamp_ns, conflicts_with = "playback_until_nsec")]
    playback_until_sec: Option<u64>,
    /// Log level: debug, info, warn, error or fatal
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
}

/// The player's parameters as flags, named as in `ros2 bag play` if it has them.
struct Player;

impl Flagged for Player {
    fn specs() -> Vec<ParameterSpec> {
        (player::NODE.parameters)()
    }

    fn flag(name: &str, flag: Arg) -> Option<Arg> {
        Some(match name {
            "bag" => return None,
            "rate" => flag.short('r'),
            "loop" => flag.short('l'),
            "delay" => flag.short('d'),
            "start_paused" => flag.short('p'),
            "regex" => flag.short('e'),
            "exclude_regex" => flag.short('x'),
            "clock" => flag.num_args(0..=1).default_missing_value("40"),
            "clock_topics_all" => flag.conflicts_with("clock_topics"),
            "restamp" => flag.conflicts_with_all(["clock", "clock_topics", "clock_topics_all"]),
            _ => flag,
        })
    }
}

fn parse_rule(text: &str) -> Result<String, String> {
    match text.split_once(":=") {
        Some((from, to)) if !from.is_empty() && !to.is_empty() => Ok(text.to_owned()),
        _ => Err("expected from:=to".to_owned()),
    }
}

impl PlayCommand {
    pub(crate) fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let mut parameters = Parameters::new();
        parameters.set("bag", &self.bag)?;
        self.flags.parameters(&mut parameters)?;
        parameters.set_some("playback_until_nsec", self.playback_until_sec)?;
        for rule in &self.remap {
            parameters.remap(rule);
        }
        parameters.log_level(self.log_level);
        (player::NODE.run)(&NodeArgs::parse(parameters.with(ros_args))?)
    }
}
