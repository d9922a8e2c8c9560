//! The player's parameters, checked.

use super::playback::{Plan, RATES};
use crate::qos_overrides;
use anyhow::{Context as _, Result, bail, ensure};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use wm_bag::{BagReader, TopicFilter};
use wm_ros::{Descriptor, Node, Qos};

/// More than a day of waiting is a mistake in the unit.
const LONGEST_S: f64 = 86_400.0;

/// More than this many messages ahead of their time are of no use.
const MOST_AHEAD: i64 = 1_000_000;

/// Time between what was played and what follows a jump in the bag, where stamps are moved: longer than what the nodes
/// take for a lost message, so that they see that another episode begins.
const GAP: Duration = Duration::from_millis(1500);

/// What the player does.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The bag's folder, or one `.mcap` file.
    pub bag: PathBuf,
    /// Seconds of the bag in a second.
    pub rate: f64,
    /// Whether it begins again at the end.
    pub is_looping: bool,
    /// How often `/clock` tells the bag's time \[Hz\]; 0: never.
    pub clock_hz: f64,
    /// Topics of whose messages `/clock` tells the log time, before each.
    pub clock_topics: Vec<String>,
    /// Whether it does so for all topics.
    pub is_clock_of_all: bool,
    /// Whether header stamps are moved to now.
    pub is_restamping: bool,
    /// Time before the first message, of each round of a loop.
    pub delay: Duration,
    /// Part of the bag's beginning that is left out.
    pub start_offset: Duration,
    /// How much of the bag is played from there.
    pub duration: Option<Duration>,
    /// Log time of the last message to play \[ns\]; the later end counts, where both are given.
    pub until_ns: Option<u64>,
    /// Whether it waits to be resumed before the first message.
    pub is_starting_paused: bool,
    /// Whether the keys of its terminal control it.
    pub has_keyboard: bool,
    /// How long it waits at the end until reliable subscribers have everything.
    pub acknowledgment: Option<Duration>,
    /// Messages that are read ahead of their time.
    pub read_ahead: usize,
    /// Quality of service of topics whose own is not to be offered.
    pub qos_overrides: BTreeMap<String, Qos>,
    /// Topics to play.
    pub topics: TopicFilter,
    /// Topics that must have a publisher and a subscriber before the first message.
    pub wait_for: Vec<String>,
    /// The longest that is waited for them.
    pub wait_timeout: Duration,
    /// Time from the last message to the player's end, for the nodes that still work on it.
    pub linger: Duration,
    /// Actions in a chunk; 0: no chunks.
    pub chunk_length: usize,
    /// The bag's topic of actions.
    pub action_topic: String,
    /// Whether the bag's last frame is published as goal.
    pub has_goal: bool,
    /// The camera topic of the goal; empty: the bag's first.
    pub camera_topic: String,
}

impl Settings {
    /// Declares the player's parameters on `node` and reads them.
    ///
    /// # Errors
    /// Names the parameter that is missing or out of range.
    pub fn declare(node: &Node) -> Result<Self> {
        let fixed = |text: &str| Descriptor::new(text).read_only();
        let text = |name: &str, default: &str, what: &str| -> Result<String> {
            Ok(node.declare(name, default.to_owned(), fixed(what))?.get())
        };
        let texts = |name: &str, what: &str| -> Result<Vec<String>> {
            let list = node.declare(name, Vec::<String>::new(), fixed(what))?.get();
            // ROS cannot write an empty list of strings: [''] stands for it
            Ok(list.into_iter().filter(|item| !item.is_empty()).collect())
        };
        let flag = |name: &str, what: &str| -> Result<bool> {
            Ok(node.declare(name, false, fixed(what))?.get())
        };
        let seconds = |name: &str, default: f64, what: &str| -> Result<Duration> {
            let value = node
                .declare(name, default, fixed(what).floats(0.0, LONGEST_S))?
                .get();
            Duration::try_from_secs_f64(value).with_context(|| format!("parameter {name:?}"))
        };

        let bag = text(
            "bag",
            "",
            "bag to play: its folder, or one .mcap file; relative to the working directory",
        )?;
        let rate = node
            .declare(
                "rate",
                1.0,
                fixed("seconds of the bag in a second").floats(*RATES.start(), *RATES.end()),
            )?
            .get();
        let clock_hz = node
            .declare(
                "clock",
                0.0,
                fixed("publish the bag's time on /clock this often [Hz]; 0: never")
                    .floats(0.0, 1000.0),
            )?
            .get();
        let chunk_length = node
            .declare(
                "action_chunk_length",
                0_i64,
                fixed("publish so many coming actions at each action; 0: none").integers(0, 1024),
            )?
            .get();
        let (topics, regex) = (
            texts("topics", "topics to play; empty: all, or those of regex")?,
            text(
                "regex",
                "",
                "play topics in whose name this is found, beside those of topics",
            )?,
        );
        let (exclude_topics, exclude_regex) = (
            texts("exclude_topics", "topics not to play")?,
            text(
                "exclude_regex",
                "",
                "do not play topics in whose name this is found",
            )?,
        );
        let given = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
        let topics = TopicFilter::new(
            topics,
            given(&regex).as_deref(),
            exclude_topics,
            given(&exclude_regex).as_deref(),
        )?;
        let duration = node
            .declare(
                "playback_duration",
                -1.0,
                fixed("how much of the bag is played [s]; negative: all").floats(-1e9, 1e9),
            )?
            .get();
        let until_ns = node
            .declare(
                "playback_until_nsec",
                -1_i64,
                fixed("log time of the last message to play [ns since 1970]; negative: the bag's; the later counts where a duration is given too"),
            )?
            .get();
        let acknowledgment = node
            .declare(
                "wait_for_all_acked",
                -1_i64,
                fixed("the longest to wait at the end until reliable subscribers have everything [ms]; 0: for ever; negative: not"),
            )?
            .get();
        let read_ahead = node
            .declare(
                "read_ahead_queue_size",
                1000_i64,
                fixed("messages to read ahead of their time, 256 MiB at most")
                    .integers(1, MOST_AHEAD),
            )?
            .get();
        let qos_overrides_path = text(
            "qos_profile_overrides_path",
            "",
            "YAML file of quality of service by topic, as ros2 bag reads it",
        )?;
        let settings = Self {
            rate,
            is_looping: flag("loop", "begin again at the end")?,
            clock_hz,
            clock_topics: texts(
                "clock_topics",
                "publish the log time on /clock before each message of these topics",
            )?,
            is_clock_of_all: flag(
                "clock_topics_all",
                "publish the log time on /clock before each message",
            )?,
            is_restamping: flag("restamp", "move header stamps from the bag's time to now")?,
            delay: seconds("delay", 0.0, "time before the first message [s]")?,
            start_offset: seconds(
                "start_offset",
                0.0,
                "part of the bag's beginning to leave out [s]",
            )?,
            duration: Duration::try_from_secs_f64(duration).ok(),
            until_ns: u64::try_from(until_ns).ok(),
            is_starting_paused: flag(
                "start_paused",
                "wait to be resumed before the first message",
            )?,
            has_keyboard: !flag(
                "disable_keyboard_controls",
                "leave the keys of the terminal alone",
            )?,
            acknowledgment: match u64::try_from(acknowledgment) {
                Ok(0) => Some(Duration::MAX),
                given => given.ok().map(Duration::from_millis),
            },
            // 1 to a million
            read_ahead: usize::try_from(read_ahead).unwrap_or(1),
            qos_overrides: qos_overrides::read(qos_overrides_path.as_ref())?,
            topics,
            wait_for: texts(
                "wait_for",
                "topics that need a publisher and a subscriber before the first message",
            )?,
            wait_timeout: seconds("wait_timeout", 10.0, "the longest to wait for them [s]")?,
            linger: seconds(
                "linger",
                0.0,
                "time from the last message to the player's end [s]",
            )?,
            chunk_length: usize::try_from(chunk_length)
                .context("parameter \"action_chunk_length\"")?,
            action_topic: text("action_topic", "/wm/action", "the bag's topic of actions")?,
            has_goal: flag("goal", "publish the bag's last frame as goal")?,
            camera_topic: text(
                "camera_topic",
                "",
                "the goal's camera topic in the bag; empty: the first",
            )?,
            bag: PathBuf::from(bag),
        };
        settings.check()?;
        Ok(settings)
    }

    fn check(&self) -> Result<()> {
        if self.bag.as_os_str().is_empty() {
            bail!("parameter \"bag\" is empty: name the bag to play");
        }
        ensure!(
            !(self.is_restamping && self.has_clock()),
            "\"restamp\" moves stamps to now and \"clock\" publishes the bag's time: give one of them"
        );
        Ok(())
    }

    /// What is played of this bag.
    #[must_use]
    pub fn plan(&self, reader: &BagReader) -> Plan {
        let start_ns = reader
            .start_ns()
            .saturating_add(nanoseconds(self.start_offset));
        Plan {
            start_ns,
            last_ns: last_ns(reader, start_ns, self.duration, self.until_ns),
            is_looping: self.is_looping,
            delay: self.delay,
            gap: if self.is_restamping {
                GAP
            } else {
                Duration::ZERO
            },
        }
    }

    /// Whether it publishes `/clock`.
    #[must_use]
    pub fn has_clock(&self) -> bool {
        self.clock_hz > 0.0 || self.is_clock_of_all || !self.clock_topics.is_empty()
    }

    /// Whether `/clock` tells of each message of this topic.
    #[must_use]
    pub fn clocks(&self, topic: &str) -> bool {
        self.is_clock_of_all || self.clock_topics.iter().any(|clocked| clocked == topic)
    }

    /// Whether the bag's topic of this name is to be played.
    #[must_use]
    pub fn plays(&self, topic: &str) -> bool {
        // with a clock of our own, the bag's would contradict it
        let is_clock = topic == "/clock" && self.has_clock();
        !is_clock && self.topics.wants(topic)
    }
}

/// Log time of the last message of a playback from `start_ns` on: as rosbag2 has it, the later of the two ends.
pub(super) fn last_ns(
    reader: &BagReader,
    start_ns: u64,
    duration: Option<Duration>,
    until_ns: Option<u64>,
) -> u64 {
    let after = duration.map(|duration| start_ns.saturating_add(nanoseconds(duration)));
    let end_ns = after.max(until_ns).unwrap_or(u64::MAX);
    end_ns.min(reader.end_ns())
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
