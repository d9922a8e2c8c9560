//! Checks of the times of messages: header stamp, publish time, log time.

use crate::{Finding, gaps::Gaps};
use std::fmt;
use wm_bag::BagMessage;

const CHECK: &str = "stamps";
/// Offset between the stamps of camera and actions, relative to log times, that proves two clocks \[s\].
const APART_S: f64 = 1.0;
/// Relative difference of the rates of two clocks that is a fault.
const RATES_APART: f64 = 0.02;
/// Shortest recording whose clock rates are compared \[s\].
const DURATION_MIN_S: f64 = 5.0;
/// Offset from the recorder's clock that proves another clock: time since the start, or simulated time \[s\].
const DAY_S: f64 = 86_400.0;
/// Share of unordered stamps that is a fault.
const UNORDERED: f64 = 0.01;
/// Limit of stored offsets per topic; a longer topic stores every second, fourth, eighth and so on.
const OFFSETS_LIMIT: usize = 2048;

/// The times of a message \[ns\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    /// Header stamp, by the sender's clock.
    pub header_ns: i64,
    /// Log time, or time of reception.
    pub log_ns: i64,
    /// Publish time; many recorders repeat the log time.
    pub publish_ns: i64,
}

/// The times of a topic's messages, in bounded memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clocks {
    /// The topic.
    pub topic: String,
    count: u64,
    zero: u64,
    /// Number of nonzero stamps equal to the previous one.
    equal: u64,
    backwards: u64,
    gaps: Gaps,
    header: Span,
    log: Span,
    last_header_ns: i64,
    /// Header stamp minus log time \[ns\], of every `stride`-th message.
    offsets_ns: Vec<i64>,
    stride: u64,
}

/// Earliest and latest time \[ns\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Span {
    least_ns: i64,
    most_ns: i64,
}

impl Stamps {
    /// The times of a bag's message with this header stamp.
    #[must_use]
    pub fn of_bag(message: &BagMessage, header_ns: i64) -> Self {
        // Never saturates: i64 reaches the year 2262.
        let signed = |ns: u64| i64::try_from(ns).unwrap_or(i64::MAX);
        Self {
            header_ns,
            log_ns: signed(message.log_time_ns),
            publish_ns: signed(message.publish_time_ns),
        }
    }
}

impl Span {
    fn grow(&mut self, at_ns: i64, is_first: bool) {
        if is_first {
            *self = Self {
                least_ns: at_ns,
                most_ns: at_ns,
            };
        }
        self.least_ns = self.least_ns.min(at_ns);
        self.most_ns = self.most_ns.max(at_ns);
    }

    fn seconds(self) -> f64 {
        seconds(self.most_ns.saturating_sub(self.least_ns))
    }

    /// The share of the shorter span that both have; 1 for a moment within the other.
    fn overlap(self, other: Self) -> f64 {
        let begin_ns = self.least_ns.max(other.least_ns);
        let end_ns = self.most_ns.min(other.most_ns);
        if end_ns < begin_ns {
            return 0.0;
        }
        let shorter = self.seconds().min(other.seconds());
        if shorter > 0.0 {
            seconds(end_ns.saturating_sub(begin_ns)) / shorter
        } else {
            1.0
        }
    }
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

impl Clocks {
    /// The clocks of a topic, without messages.
    #[must_use]
    pub fn new(topic: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            stride: 1,
            ..Self::default()
        }
    }

    /// Adds the times of the next message.
    pub fn push(&mut self, stamps: Stamps) {
        let Stamps {
            header_ns, log_ns, ..
        } = stamps;
        let is_first = self.count == 0;
        if header_ns == 0 {
            self.zero += 1;
        }
        if !is_first {
            match header_ns.cmp(&self.last_header_ns) {
                std::cmp::Ordering::Less => self.backwards += 1,
                std::cmp::Ordering::Equal if header_ns != 0 => self.equal += 1,
                _ if header_ns == 0 || self.last_header_ns == 0 => {}
                _ => self
                    .gaps
                    .push(header_ns.saturating_sub(self.last_header_ns)),
            }
        }
        self.last_header_ns = header_ns;
        // 0 means no stamp.
        let is_first_stamp = self.count == self.zero.saturating_sub(u64::from(header_ns == 0));
        if header_ns != 0 {
            self.header.grow(header_ns, is_first_stamp);
        }
        self.log.grow(log_ns, is_first);
        if self.count.is_multiple_of(self.stride) && header_ns != 0 {
            self.offsets_ns.push(header_ns.saturating_sub(log_ns));
            if self.offsets_ns.len() >= OFFSETS_LIMIT {
                let mut index = 0_usize;
                self.offsets_ns.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
        }
        self.count += 1;
    }

    /// The number of messages.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The times between successive stamps.
    pub(crate) fn gaps(&self) -> &Gaps {
        &self.gaps
    }

    /// The fault of header stamps that are all zero or all equal.
    #[must_use]
    pub fn unusable(&self) -> Option<UnusableStamps> {
        if self.count < 2 {
            return None;
        }
        let topic = self.topic.clone();
        if self.zero == self.count {
            return Some(UnusableStamps::Zero { topic });
        }
        (self.zero == 0 && self.header.least_ns == self.header.most_ns).then_some(
            UnusableStamps::Constant {
                topic,
                stamp_ns: self.header.least_ns,
            },
        )
    }

    /// Median of header stamp minus log time \[s\].
    pub(crate) fn offset_s(&self) -> Option<f64> {
        let mut offsets = self.offsets_ns.clone();
        offsets.sort_unstable();
        offsets.get(offsets.len() / 2).copied().map(seconds)
    }

    /// Checks the stamps of this topic alone.
    #[must_use]
    pub fn check(&self) -> Vec<Finding> {
        if let Some(unusable) = self.unusable() {
            return vec![
                Finding::error(CHECK, unusable.to_string())
                    .because("frames and actions are matched by their stamps")
                    .fix(USE_OTHERS)
                    .figure("messages", self.count as f64),
            ];
        }
        let topic = &self.topic;
        let mut findings = Vec::new();
        // A simulated clock may start at 0.
        if self.zero > 1 {
            let what = format!("{topic}: {} of {} stamps are 0", self.zero, self.count);
            findings.push(
                Finding::warning(CHECK, what)
                    .because("messages without a stamp are dropped")
                    .fix(USE_OTHERS)
                    .figure("zero_stamps", self.zero as f64),
            );
        }
        let unordered = self.equal + self.backwards;
        if unordered > 0 {
            let share = unordered as f64 / self.count as f64;
            let what = format!(
                "{topic}: {unordered} of {} stamps are not later than the one before ({} equal, {} earlier)",
                self.count, self.equal, self.backwards
            );
            let level = if share > UNORDERED {
                Finding::warning
            } else {
                Finding::note
            };
            findings.push(
                level(CHECK, what)
                    .because("such messages are dropped, or start a new recording")
                    .fix("use one publisher for each topic, and stamp with the time of capture")
                    .figure("unordered_stamps", unordered as f64),
            );
        }
        findings
    }

    pub(crate) fn check_gaps(&self) -> Option<Finding> {
        let (missing, longest_s) = self.gaps.missing();
        (missing > 0).then(|| {
            let what = format!(
                "{}: {missing} of {} messages are missing; the longest gap lasts {longest_s:.2} s",
                self.topic,
                self.count + missing
            );
            Finding::note("dropped", what)
                .because("the state is unknown between distant messages")
                .figure("missing", missing as f64)
                .figure("longest_gap_s", longest_s)
        })
    }

    /// Checks the stamps of a camera and of the actions together.
    pub(crate) fn check_pair(camera: &Self, actions: &Self) -> Option<Finding> {
        if camera.unusable().is_some() || actions.unusable().is_some() {
            return None;
        }
        let both = format!("{} and {}", camera.topic, actions.topic);
        let why =
            "actions are matched with frames by their stamps, here with frames of another moment";
        let apart = |what: String| {
            Finding::error(CHECK, what)
                .because(why)
                .fix("stamp both by one clock; for this recording: --stamps log")
        };
        // Constant log times, or those of another clock, are no reference.
        let is_logged = camera.log.overlap(actions.log) > 0.5 && camera.log.seconds() > 0.0;
        let share = camera.header.overlap(actions.header);
        let (camera_s, actions_s) = (camera.offset_s()?, actions.offset_s()?);
        let apart_s = camera_s - actions_s;
        if is_logged && apart_s.abs() > APART_S {
            let what = format!(
                "{both}: the stamps are {} apart, of two clocks",
                Span::text(apart_s)
            );
            return Some(apart(what).figure("apart_s", apart_s));
        }
        // Messages without a stamp are not part of the header's span.
        let is_stamped = camera.zero <= 1 && actions.zero <= 1;
        let is_long =
            camera.log.seconds() > DURATION_MIN_S && actions.log.seconds() > DURATION_MIN_S;
        if is_logged && is_stamped && is_long {
            let rate = |clocks: &Self| clocks.header.seconds() / clocks.log.seconds();
            let ratio = rate(camera) / rate(actions);
            if (ratio - 1.0).abs() > RATES_APART {
                let what = format!(
                    "{both}: a second of the camera's clock lasts {ratio:.2} s of the actions' clock"
                );
                return Some(apart(what).figure("clock_ratio", ratio));
            }
        }
        if !is_logged && share < 0.5 {
            let what = format!("{both}: neither stamps nor log times are of one time");
            return Some(
                apart(what)
                    .fix("record both at the same time, with a recorder that stamps messages"),
            );
        }
        if !is_logged {
            let what =
                format!("{both}: log times are not of one time; the stamps in the headers are");
            return Some(Finding::note(CHECK, what));
        }
        if camera_s.abs() > DAY_S && camera.log.least_ns > 0 {
            let what = format!(
                "{both}: stamped by another clock than the recorder's ({} apart), both by the same one",
                Span::text(camera_s)
            );
            return Some(Finding::note(CHECK, what).figure("offset_s", camera_s));
        }
        None
    }
}

impl Span {
    /// A duration with a suitable unit.
    fn text(seconds: f64) -> String {
        let magnitude = seconds.abs();
        if magnitude > 2.0 * DAY_S {
            format!("{:.0} days", magnitude / DAY_S)
        } else {
            format!("{magnitude:.1} s")
        }
    }
}

const USE_OTHERS: &str = "have the driver stamp each message with the time of its capture; for this recording: \
                          --stamps log (or publish)";

/// Unusable header stamps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UnusableStamps {
    /// All are 0.
    Zero {
        /// Of this topic.
        topic: String,
    },
    /// All are equal.
    Constant {
        /// Of this topic.
        topic: String,
        /// The stamp \[ns\].
        stamp_ns: i64,
    },
}

impl fmt::Display for UnusableStamps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Zero { topic } => write!(f, "{topic}: every stamp is 0"),
            Self::Constant { topic, stamp_ns } => {
                write!(f, "{topic}: every stamp is the same, {stamp_ns} ns")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::Level;

    const START: i64 = 1_750_000_000_000_000_000;
    const PERIOD: i64 = 200_000_000;

    /// Messages at 5 Hz with header and log times as functions of the true time \[ns\].
    fn clocks(topic: &str, header: impl Fn(i64) -> i64, log: impl Fn(i64) -> i64) -> Clocks {
        let mut clocks = Clocks::new(topic);
        for index in 0..100 {
            let at_ns = START + index * PERIOD;
            clocks.push(Stamps {
                header_ns: header(at_ns),
                log_ns: log(at_ns),
                publish_ns: log(at_ns),
            });
        }
        clocks
    }

    fn good(topic: &str) -> Clocks {
        clocks(topic, |at| at - 30_000_000, |at| at)
    }

    #[test]
    fn good_stamps_have_no_finding() {
        let (camera, actions) = (good("/camera"), clocks("/action", |at| at, |at| at));
        assert_eq!(camera.check(), []);
        assert_eq!(Clocks::check_pair(&camera, &actions), None);
        assert!((camera.offset_s().unwrap() + 0.03).abs() < 1e-9);
    }

    #[test]
    fn zero_and_constant_stamps_are_unusable() {
        let zero = clocks("/camera", |_| 0, |at| at);
        let constant = clocks("/camera", |_| START, |at| at);
        for (clocks, named) in [(zero, "every stamp is 0"), (constant, "is the same")] {
            let findings = clocks.check();
            assert_eq!(findings.len(), 1);
            assert_eq!(findings[0].level, Level::Error);
            assert!(findings[0].what.contains(named), "{findings:?}");
            assert!(findings[0].fix.as_ref().unwrap().contains("--stamps log"));
        }
    }

    #[test]
    fn stamps_of_zero_among_others_are_counted() {
        let half = clocks(
            "/camera",
            |at| if at < START + 50 * PERIOD { 0 } else { at },
            |at| at,
        );
        let findings = half.check();
        assert!(
            findings[0].what.contains("50 of 100 stamps are 0"),
            "{findings:?}"
        );
        assert_eq!(half.unusable(), None);
        assert_eq!(Clocks::check_pair(&half, &good("/action")), None);
        // A simulated clock begins at 0.
        assert_eq!(clocks("/camera", |at| at - START, |at| at).check(), []);
    }

    #[test]
    fn clock_that_counts_from_boot_is_another_clock() {
        let camera = clocks("/camera", |at| at - START + 100_000_000_000, |at| at);
        let found = Clocks::check_pair(&camera, &good("/action")).unwrap();
        assert_eq!(found.level, Level::Error);
        assert!(found.what.contains("days apart"), "{}", found.what);
        let late = clocks("/camera", |at| at - 170_000_000_000, |at| at);
        let found = Clocks::check_pair(&late, &good("/action")).unwrap();
        assert!(found.what.contains("170.0 s apart"), "{}", found.what);
    }

    #[test]
    fn shared_clock_may_differ_from_the_recorders() {
        let simulated = |topic| clocks(topic, |at| at - START, |at| at);
        let found = Clocks::check_pair(&simulated("/camera"), &simulated("/action")).unwrap();
        assert_eq!(found.level, Level::Note);
        // A simulation at half real time.
        let slow = |topic| clocks(topic, |at| START + (at - START) / 2, |at| at);
        assert_eq!(Clocks::check_pair(&slow("/camera"), &slow("/action")), None);
    }

    #[test]
    fn clocks_of_different_rates_are_found() {
        let fast = clocks("/camera", |at| START + (at - START) / 100 * 103, |at| at);
        let found = Clocks::check_pair(&fast, &clocks("/action", |at| at, |at| at)).unwrap();
        assert_eq!(found.level, Level::Error);
        assert!(found.what.contains("1.03 s"), "{}", found.what);
    }

    #[test]
    fn zero_log_times_do_not_invalidate_good_stamps() {
        let actions = clocks("/action", |at| at, |_| 0);
        let found = Clocks::check_pair(&good("/camera"), &actions).unwrap();
        assert_eq!(found.level, Level::Note);
    }

    #[test]
    fn many_backward_stamps_are_a_fault() {
        let mut few = good("/camera");
        few.push(Stamps {
            header_ns: START,
            ..Stamps::default()
        });
        assert_eq!(few.check()[0].level, Level::Note);
        let pairs = clocks("/camera", |at| at - (at - START) % (2 * PERIOD), |at| at);
        let found = &pairs.check()[0];
        assert_eq!(found.level, Level::Warning);
        assert!(found.what.contains("50 equal, 0 earlier"), "{}", found.what);
    }

    #[test]
    fn gap_of_the_state_is_named() {
        let mut joints = Clocks::new("/joint_states");
        for index in (0..300).filter(|index| !(120..150).contains(index)) {
            joints.push(Stamps {
                header_ns: START + index * 10_000_000,
                ..Stamps::default()
            });
        }
        let found = joints.check_gaps().unwrap();
        assert!(
            found.what.contains("30 of 300 messages are missing"),
            "{}",
            found.what
        );
        assert!(found.what.contains("0.31 s"), "{}", found.what);
        assert_eq!(good("/joint_states").check_gaps(), None);
        // The time from a zero stamp to a real one is not a gap.
        let mut late = Clocks::new("/joint_states");
        for index in (0..100).filter(|index| *index != 50) {
            late.push(Stamps {
                header_ns: if index < 10 {
                    0
                } else {
                    START + index * 10_000_000
                },
                ..Stamps::default()
            });
        }
        let found = late.check_gaps().unwrap();
        assert!(found.what.contains("0.02 s"), "{}", found.what);
    }

    #[test]
    fn memory_does_not_grow_with_the_recording() {
        let mut long = Clocks::new("/camera");
        for index in 0..20 * OFFSETS_LIMIT as i64 {
            long.push(Stamps {
                header_ns: START + index * PERIOD,
                log_ns: START + index * PERIOD + 5_000_000,
                publish_ns: 0,
            });
        }
        assert!(long.offsets_ns.len() <= OFFSETS_LIMIT);
        assert!((long.offset_s().unwrap() + 0.005).abs() < 1e-9);
    }
}
