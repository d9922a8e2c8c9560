//! The player's parameters, checked.

use super::playback::{Plan, RATES};
use crate::qos_overrides;
use anyhow::{Result, bail, ensure};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use wm_bag::{BagReader, TopicFilter};
use wm_ros::{Error, Node, Qos};

/// Default topic of the actions in a bag.
pub(super) const ACTION_TOPIC: &str = "/wm/action";

/// Longest time of the parameters \[s\]: more than a day is a mistake in the unit.
const LONGEST_S: f64 = 86_400.0;

/// Most messages to read ahead: more have no use.
const MOST_AHEAD: i64 = 1_000_000;

/// Time between the messages before and after a jump in the bag if stamps are changed. It is longer than a lost message, so
/// that nodes detect the next episode.
const GAP: Duration = Duration::from_millis(1500);

wm_ros::parameters! {
    /// The node's parameters.
    #[derive(Clone, Debug)]
    pub struct Parameters {
        /// Bag to play: its folder or a single .mcap file, relative to the working directory.
        pub bag: PathBuf = "";
        /// Playback rate: seconds of the bag per second.
        pub rate: f64 = 1.0, in RATES;
        /// Start again at the end of the bag.
        pub is_looping as "loop": bool = false;
        /// Rate at which the bag's time is published on /clock [Hz], for nodes with use_sim_time; 0: never. Not with
        /// restamp.
        pub clock_hz as "clock": f64 = 0.0, in 0.0..=1000.0;
        /// Publish the log time on /clock before each message of these topics. Not with restamp.
        pub clock_topics: Vec<String> = Vec::<String>::new();
        /// Publish the log time on /clock before each message. Not with restamp.
        pub is_clock_of_all as "clock_topics_all": bool = false;
        /// Shift header stamps from the bag's time to the present, so that nodes measure latencies as with live data.
        pub is_restamping as "restamp": bool = false;
        /// Delay before the first message [s], also in each round of a loop.
        pub delay: Duration = 0.0, in 0.0..=LONGEST_S;
        /// Start this long after the beginning of the bag [s].
        pub start_offset: Duration = 0.0, in 0.0..=LONGEST_S;
        /// Skip gaps between messages that are longer than this [s in the bag]; 0: wait for every message.
        pub max_gap: Duration = 10.0, in 0.0..=LONGEST_S;
        /// Duration to play [s]; negative: to the end of the bag.
        playback_duration: f64 = -1.0, in -1e9..=1e9;
        /// Log time of the last message to play [ns since 1970]; negative: the last of the bag. If a duration is also
        /// given, the later of the two ends applies.
        playback_until_nsec: i64 = -1;
        /// Start paused: the first message waits until the player is resumed.
        pub is_starting_paused as "start_paused": bool = false;
        /// Ignore the keyboard.
        disable_keyboard_controls: bool = false;
        /// How long to wait at the end for acknowledgements from reliable subscribers [ms]; 0: without limit; negative:
        /// do not wait.
        wait_for_all_acked: i64 = -1;
        /// Number of messages to read ahead; at most 256 MiB of them.
        pub read_ahead as "read_ahead_queue_size": usize = 1000, in 1..=MOST_AHEAD;
        /// YAML file with the QoS of each topic, in the format of ros2 bag; empty: QoS as recorded.
        qos_profile_overrides_path: PathBuf = "";
        /// Topics to play; empty: all topics, or those that match regex.
        topics: Vec<String> = Vec::<String>::new();
        /// Also play topics whose name contains a match of this regular expression.
        regex: String = "";
        /// Topics not to play.
        exclude_topics: Vec<String> = Vec::<String>::new();
        /// Do not play topics whose name contains a match of this regular expression.
        exclude_regex: String = "";
        /// Before the first message, wait until each of these topics has a publisher and a subscriber and the graph has
        /// not changed for half a second.
        pub wait_for: Vec<String> = Vec::<String>::new();
        /// Maximum time to wait for the topics in wait_for [s].
        pub wait_timeout: Duration = 10.0, in 0.0..=LONGEST_S;
        /// How long the player keeps running after the last message [s], while nodes still work on it.
        pub linger: Duration = 0.0, in 0.0..=LONGEST_S;
        /// With each action, publish this many next actions on /wm/action_chunk; 0: none.
        pub chunk_length as "action_chunk_length": usize = 0, in 0..=1024;
        /// Topic of the actions in the bag.
        pub action_topic: String = ACTION_TOPIC;
        /// Publish the last frame of the bag as the goal, on /wm/goal/image/compressed.
        pub has_goal as "goal": bool = false;
        /// Camera topic in the bag from which the goal is taken; empty: the first camera.
        pub camera_topic: String = "";
    }
}

/// The checked parameters.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The parameters.
    pub parameters: Arc<Parameters>,
    /// Topics to play.
    pub topics: TopicFilter,
    /// QoS of topics that differs from the recorded one.
    pub qos_overrides: BTreeMap<String, Qos>,
}

impl Settings {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Names the missing or contradictory parameter.
    pub fn new(parameters: Arc<Parameters>) -> Result<Self> {
        let non_empty = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
        let settings = Self {
            topics: TopicFilter::new(
                parameters.topics.clone(),
                non_empty(&parameters.regex).as_deref(),
                parameters.exclude_topics.clone(),
                non_empty(&parameters.exclude_regex).as_deref(),
            )?,
            qos_overrides: qos_overrides::read(&parameters.qos_profile_overrides_path)?,
            parameters,
        };
        settings.check()?;
        Ok(settings)
    }

    fn check(&self) -> Result<()> {
        if self.parameters.bag.as_os_str().is_empty() {
            bail!("parameter \"bag\" is empty: give the bag to play");
        }
        ensure!(
            !(self.parameters.is_restamping && self.has_clock()),
            "\"restamp\" shifts stamps to the present and \"clock\" publishes the bag's time: set only one of them"
        );
        Ok(())
    }

    /// Whether the keys of the terminal control the playback.
    #[must_use]
    pub fn has_keyboard(&self) -> bool {
        !self.parameters.disable_keyboard_controls
    }

    /// Longest wait at the end for the acknowledgements of reliable subscribers; `None`: no wait.
    #[must_use]
    pub fn acknowledgment(&self) -> Option<Duration> {
        match u64::try_from(self.parameters.wait_for_all_acked) {
            Ok(0) => Some(Duration::MAX),
            limit => limit.ok().map(Duration::from_millis),
        }
    }

    /// The part of this bag to play, and the pauses.
    #[must_use]
    pub fn plan(&self, reader: &BagReader) -> Plan {
        let start_ns = start_ns(reader, self.parameters.start_offset);
        let duration = Duration::try_from_secs_f64(self.parameters.playback_duration).ok();
        let until_ns = u64::try_from(self.parameters.playback_until_nsec).ok();
        Plan {
            start_ns,
            last_ns: last_ns(reader, start_ns, duration, until_ns),
            is_looping: self.parameters.is_looping,
            delay: self.parameters.delay,
            max_gap: Some(self.parameters.max_gap).filter(|most| !most.is_zero()),
            gap: if self.parameters.is_restamping {
                GAP
            } else {
                Duration::ZERO
            },
        }
    }

    /// Whether the player publishes `/clock`.
    #[must_use]
    pub fn has_clock(&self) -> bool {
        self.parameters.clock_hz > 0.0
            || self.parameters.is_clock_of_all
            || !self.parameters.clock_topics.is_empty()
    }

    /// Whether the player publishes `/clock` before each message of this topic.
    #[must_use]
    pub fn clocks(&self, topic: &str) -> bool {
        self.parameters.is_clock_of_all
            || self
                .parameters
                .clock_topics
                .iter()
                .any(|clocked| clocked == topic)
    }

    /// Whether this topic of the bag is played.
    #[must_use]
    pub fn plays(&self, topic: &str) -> bool {
        // The recorded clock would contradict the player's own.
        let is_clock = topic == "/clock" && self.has_clock();
        !is_clock && self.topics.wants(topic)
    }
}

/// Whether the node's parameters request `/clock`, as [`Settings::has_clock`].
pub(super) fn has_clock(node: &Node) -> Result<bool, Error> {
    let rate_hz: f64 = node.parameter("clock")?;
    let topics: Vec<String> = node.parameter("clock_topics")?;
    Ok(rate_hz > 0.0
        || node.parameter("clock_topics_all")?
        || topics.iter().any(|topic| !topic.is_empty()))
}

/// Log time at which a playback begins: the start of the bag, or `offset` after the start of the recording.
pub(super) fn start_ns(reader: &BagReader, offset: Duration) -> u64 {
    match offset {
        Duration::ZERO => reader.start_ns(),
        offset => reader.time_at(offset),
    }
}

/// Log time of the last message of a playback from `start_ns` on: the later of the two ends, as in rosbag2.
pub(super) fn last_ns(
    reader: &BagReader,
    start_ns: u64,
    duration: Option<Duration>,
    until_ns: Option<u64>,
) -> u64 {
    // Durations count from the start of the recording. A message without a time may be far from it.
    let origin_ns = start_ns.max(reader.time_at(Duration::ZERO));
    let after = duration.map(|duration| origin_ns.saturating_add(nanoseconds(duration)));
    // Without a limit, the end of the bag counts.
    let end_ns = after.max(until_ns).unwrap_or(u64::MAX);
    end_ns.min(reader.end_ns())
}

fn nanoseconds(duration: Duration) -> u64 {
    // 584 years.
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
