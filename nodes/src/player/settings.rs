//! The player's parameters, checked.

use anyhow::{Context as _, Result, bail, ensure};
use std::path::PathBuf;
use std::time::Duration;
use wm_bag::BagReader;
use wm_ros::{Descriptor, Node};

/// More than a day of waiting is a mistake in the unit.
const LONGEST_S: f64 = 86_400.0;

/// What the player does.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The bag's folder, or one `.mcap` file.
    pub bag: PathBuf,
    /// Seconds of the bag in a second.
    pub rate: f64,
    /// Whether it begins again at the end.
    pub is_looping: bool,
    /// How often `/clock` tells the bag's time \[Hz\]; 0: never.
    pub clock_hz: f64,
    /// Whether header stamps are moved to now.
    pub is_restamping: bool,
    /// Time before the first message.
    pub delay: Duration,
    /// Part of the bag's beginning that is left out.
    pub start_offset: Duration,
    /// Topics to play; empty: all.
    pub topics: Vec<String>,
    /// Topics not to play.
    pub exclude_topics: Vec<String>,
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
                fixed("seconds of the bag in a second").floats(0.001, 1000.0),
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
        let settings = Self {
            rate,
            is_looping: flag("loop", "begin again at the end")?,
            clock_hz,
            is_restamping: flag("restamp", "move header stamps from the bag's time to now")?,
            delay: seconds("delay", 0.0, "time before the first message [s]")?,
            start_offset: seconds(
                "start_offset",
                0.0,
                "part of the bag's beginning to leave out [s]",
            )?,
            topics: texts("topics", "topics to play; empty: all")?,
            exclude_topics: texts("exclude_topics", "topics not to play")?,
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
            !(self.is_restamping && self.clock_hz > 0.0),
            "\"restamp\" moves stamps to now and \"clock\" publishes the bag's time: give one of them"
        );
        Ok(())
    }

    /// Log time of the first message that is played \[ns\].
    #[must_use]
    pub fn start_ns(&self, reader: &BagReader) -> u64 {
        let offset_ns = u64::try_from(self.start_offset.as_nanos()).unwrap_or(u64::MAX);
        reader.start_ns().saturating_add(offset_ns)
    }

    /// Whether the bag's topic of this name is to be played.
    #[must_use]
    pub fn plays(&self, topic: &str) -> bool {
        // with a clock of our own, the bag's would contradict it
        let is_clock = topic == "/clock" && self.clock_hz > 0.0;
        let is_wanted = self.topics.is_empty() || self.topics.iter().any(|wanted| wanted == topic);
        is_wanted && !is_clock && !self.exclude_topics.iter().any(|excluded| excluded == topic)
    }
}
