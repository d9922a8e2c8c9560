//! Faults of a running node, determined only from counts and times: missing inputs, missed deadlines, growing memory,
//! and conditions that the node reports. Each has a level and a sentence with the remedy.

mod deadline;
mod input;
mod memory;

pub use deadline::Deadline;
pub use input::Input;
pub(super) use memory::resident;

use super::Level;
use deadline::DeadlineWatch;
use input::InputWatch;
use memory::MemoryWatch;
use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

/// How long a condition holds after its last report: longer than a second, so that each report includes every lasting
/// condition.
const HOLD: Duration = Duration::from_secs(5);

/// The most conditions; their subjects contain topics and could be many.
const MAX_CONDITIONS: usize = 64;

/// A finding of the watchdog on one subject.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Finding {
    /// `input latent`
    pub(super) subject: String,
    pub(super) level: Level,
    /// The state, and for a fault the remedy.
    pub(super) message: String,
}

#[derive(Debug)]
struct Condition {
    level: Level,
    message: String,
    seen: Instant,
}

/// The publishers in the graph.
pub(super) trait Publishers {
    /// The number of publishers connected to the node's subscription of `topic`.
    fn connected(&self, topic: &str) -> usize;
    /// Topics of the same type from outside the suite.
    fn elsewhere(&self, topic: &str) -> BTreeSet<String>;
    /// Whether no other node of the suite publishes `topic`: it is not in the node's namespace.
    fn is_from_outside(&self, topic: &str) -> bool;
}

/// The watches of one node. It has no clock: each call passes the time.
#[derive(Debug, Default)]
pub(super) struct Watchdog {
    inputs: BTreeMap<&'static str, InputWatch>,
    deadlines: BTreeMap<&'static str, DeadlineWatch>,
    memory: MemoryWatch,
    conditions: BTreeMap<String, Condition>,
    /// Findings that are not logged yet.
    news: Vec<Finding>,
}

impl Watchdog {
    /// Watches an input from now on.
    pub(super) fn expect(&mut self, input: Input, now: Instant) {
        self.inputs.insert(input.name, InputWatch::new(input, now));
    }

    /// Stops watching inputs and deadlines, and restarts the memory measurement.
    pub(super) fn stand_down(&mut self) {
        self.inputs.clear();
        self.deadlines.clear();
        self.news.clear();
        self.memory = MemoryWatch::default();
    }

    /// Counts a message of this topic.
    pub(super) fn arrived(&mut self, topic: &str, now: Instant) {
        for input in self.inputs.values_mut() {
            input.arrived(topic, now);
        }
    }

    /// Counts a run of a stage; its deadline may change between calls.
    pub(super) fn took(&mut self, deadline: Deadline, taken: Duration) {
        self.deadlines
            .entry(deadline.stage)
            .or_insert_with(|| DeadlineWatch::new(deadline))
            .took(deadline, taken);
    }

    /// Reports a condition that holds now. Without a further report within five seconds it counts as over.
    pub(super) fn raise(&mut self, subject: &str, level: Level, message: String, now: Instant) {
        if self.conditions.len() >= MAX_CONDITIONS && !self.conditions.contains_key(subject) {
            return;
        }
        let condition = Condition {
            level,
            message,
            seen: now,
        };
        self.conditions.insert(subject.to_owned(), condition);
    }

    /// Inputs from outside the suite that are missing or back since the report before the last. Inputs from nodes of
    /// the suite are omitted: the node that publishes them reports the cause.
    pub(super) fn take_news(&mut self) -> Vec<Finding> {
        std::mem::take(&mut self.news)
    }

    /// The state of every watch. `resident`: the process's memory \[byte\], if known.
    pub(super) fn report(
        &mut self,
        now: Instant,
        publishers: &dyn Publishers,
        resident: Option<u64>,
    ) -> Vec<Finding> {
        let mut findings: Vec<Finding> = Vec::new();
        for input in self.inputs.values_mut() {
            let finding = input.judge(now, publishers);
            if input.is_news(now, publishers) {
                self.news.push(finding.clone());
            }
            findings.push(finding);
        }
        for deadline in self.deadlines.values_mut() {
            findings.push(deadline.judge());
        }
        if let Some(resident) = resident {
            findings.push(self.memory.judge(now, resident));
        }
        self.conditions
            .retain(|_, condition| now.saturating_duration_since(condition.seen) <= HOLD);
        findings.extend(self.conditions.iter().map(|(subject, condition)| Finding {
            subject: subject.clone(),
            level: condition.level,
            message: condition.message.clone(),
        }));
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A graph in which nobody publishes.
    struct Nobody;

    impl Publishers for Nobody {
        fn connected(&self, _: &str) -> usize {
            0
        }

        fn elsewhere(&self, _: &str) -> BTreeSet<String> {
            BTreeSet::new()
        }

        fn is_from_outside(&self, topic: &str) -> bool {
            !topic.starts_with("/wm/")
        }
    }

    #[test]
    fn missing_outside_input_is_logged_once_and_again_on_return() {
        let (mut watchdog, start) = (Watchdog::default(), Instant::now());
        watchdog.expect(Input::new("images", ["/image"], "start the camera"), start);
        watchdog.expect(Input::new("latents", ["/wm/latent"], "start it"), start);
        let news = |watchdog: &mut Watchdog, seconds| -> Vec<String> {
            let now = start + Duration::from_secs(seconds);
            watchdog.report(now, &Nobody, None);
            let news = watchdog.take_news();
            news.into_iter().map(|finding| finding.message).collect()
        };
        assert_eq!(news(&mut watchdog, 1), [""; 0]);
        let said = news(&mut watchdog, 9);
        assert!(
            said.len() == 1 && said[0].contains("no images on /image"),
            "{said:?}"
        );
        assert_eq!(news(&mut watchdog, 10), [""; 0]);
        watchdog.arrived("/image", start + Duration::from_secs(11));
        assert_eq!(news(&mut watchdog, 11), ["images come"]);
        // A short gap is only on /diagnostics.
        assert_eq!(news(&mut watchdog, 12), [""; 0]);
        assert!(news(&mut watchdog, 17)[0].contains("no images on /image for 6.0 s"));
    }

    #[test]
    fn a_condition_holds_while_it_is_said_and_ends_by_itself() {
        let (mut watchdog, start) = (Watchdog::default(), Instant::now());
        watchdog.raise("latent space", Level::Error, "wrong".to_owned(), start);
        let at = |watchdog: &mut Watchdog, seconds| {
            let now = start + Duration::from_secs(seconds);
            watchdog.report(now, &Nobody, None).len()
        };
        assert_eq!((at(&mut watchdog, 4), at(&mut watchdog, 6)), (1, 0));
        for index in 0..100 {
            watchdog.raise(&index.to_string(), Level::Warn, String::new(), start);
        }
        assert_eq!(at(&mut watchdog, 1), MAX_CONDITIONS);
    }

    #[test]
    fn who_stands_down_misses_nothing() {
        let (mut watchdog, start) = (Watchdog::default(), Instant::now());
        let input = Input::new("latents", ["/wm/latent"], "start the encoder");
        watchdog.expect(input, start);
        let now = start + Duration::from_secs(60);
        assert_eq!(watchdog.report(now, &Nobody, None).len(), 1);
        watchdog.stand_down();
        assert_eq!(watchdog.report(now, &Nobody, None), []);
    }
}
