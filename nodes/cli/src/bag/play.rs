//! `wm bag play`, with the options of `ros2 bag play`.

use super::{parameters::Parameters, time::parse_stamp_ns, topic_options::TopicOptions};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_bag_nodes::player;
use wm_ros::NodeArgs;

/// Plays a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "Keys, where it runs in a terminal: space pauses and resumes, cursor right plays the next message of a paused\n\
    playback, up and down change the rate by 0.1.\n\n\
    Services, of rosbag2_interfaces: ~/pause ~/resume ~/toggle_paused ~/is_paused ~/get_rate ~/set_rate ~/play_next\n\
    ~/burst ~/seek ~/play ~/stop; the node's name is /wm/player.\n\n\
    Examples:\n  \
    wm bag play run --clock --rate 0.5 --start-offset 10 --playback-duration 5\n  \
    wm bag play run -e '^/camera/' -x '/compressedDepth$' -m /camera/image_raw:=/front\n  \
    ros2 service call /wm/player/pause rosbag2_interfaces/srv/Pause\n\n\
    Exit codes: 0 everything was played, 3 something was lost or unreadable, 1 failed."
)]
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
    /// Publish the log time on /clock before each message of these topics
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    clock_topics: Vec<String>,
    /// Publish the log time on /clock before each message
    #[arg(long, conflicts_with = "clock_topics")]
    clock_topics_all: bool,
    /// Play under other names
    #[arg(short = 'm', long, value_name = "FROM:=TO", num_args = 1.., value_parser = parse_rule)]
    remap: Vec<String>,
    /// Wait before the first message, in each round of a loop, in seconds
    #[arg(short, long, value_name = "SECONDS", default_value_t = 0.0)]
    delay: f64,
    /// Leave out so much of the beginning, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    start_offset: f64,
    /// Play so much of the bag, in seconds; negative: all
    #[arg(long, value_name = "SECONDS", default_value_t = -1.0, allow_negative_numbers = true)]
    playback_duration: f64,
    /// Play what was logged until this time; the later end counts, where a duration is given too. STAMP is seconds
    /// since 1970 (1700000000.25) or a date (2023-11-14T22:13:20.25Z)
    #[arg(long, value_name = "STAMP", value_parser = parse_stamp_ns)]
    playback_until_sec: Option<u64>,
    /// Play what was logged until this time, in nanoseconds since 1970
    #[arg(
        long,
        value_name = "NANOSECONDS",
        conflicts_with = "playback_until_sec"
    )]
    playback_until_nsec: Option<u64>,
    #[command(flatten)]
    topics: TopicOptions,
    /// YAML file of quality of service by topic, as ros2 bag reads it
    #[arg(long, value_name = "FILE")]
    qos_profile_overrides_path: Option<PathBuf>,
    /// Wait to be resumed before the first message
    #[arg(short = 'p', long)]
    start_paused: bool,
    /// Leave the keys of the terminal alone
    #[arg(long)]
    disable_keyboard_controls: bool,
    /// At the end, wait until reliable subscribers have everything, at most for so long; 0: for ever
    #[arg(long, value_name = "MILLISECONDS")]
    wait_for_all_acked: Option<u32>,
    /// Messages to read ahead of their time; 256 MiB at most
    #[arg(long, value_name = "N")]
    read_ahead_queue_size: Option<i64>,
    /// What is logged: debug, info, warn, error or fatal
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
    /// Move header stamps from the bag's time to now
    #[arg(long, conflicts_with_all = ["clock", "clock_topics", "clock_topics_all"])]
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
        parameters.set_list("clock_topics", &self.clock_topics)?;
        parameters.set("clock_topics_all", self.clock_topics_all)?;
        parameters.set("playback_duration", self.playback_duration)?;
        let until_ns = self.playback_until_sec.or(self.playback_until_nsec);
        parameters.set_some("playback_until_nsec", until_ns)?;
        self.topics.parameters(&mut parameters)?;
        let overrides = self.qos_profile_overrides_path;
        parameters.set_some("qos_profile_overrides_path", overrides)?;
        parameters.set("start_paused", self.start_paused)?;
        parameters.set("disable_keyboard_controls", self.disable_keyboard_controls)?;
        parameters.set_some("wait_for_all_acked", self.wait_for_all_acked)?;
        parameters.set_some("read_ahead_queue_size", self.read_ahead_queue_size)?;
        parameters.set("restamp", self.restamp)?;
        parameters.set_list("wait_for", &self.wait_for)?;
        parameters.set("wait_timeout", self.wait_timeout)?;
        parameters.set("action_chunk_length", self.action_chunk_length)?;
        parameters.set("goal", self.goal)?;
        for rule in &self.remap {
            parameters.remap(rule);
        }
        parameters.log_level(self.log_level);
        Ok(player::run(&NodeArgs::parse(parameters.with(ros_args))?)?.into())
    }
}
