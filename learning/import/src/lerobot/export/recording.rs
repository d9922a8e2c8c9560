use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use crate::lerobot::{
    LeRobotError,
    info::{ACTION, IMAGES},
    topics::{ACTION_TOPIC, GRIPPER_TOPIC},
};

/// A silence is longer than this many periods of its topic ...
const SILENT_PERIODS: u64 = 10;
/// ... but at least the first and at most the second duration \[ns\]: the audit's limit of a missing frame, and the bag's
/// limit of a gap.
const SHORT_NS: u64 = 1_000_000_000;
const LONG_NS: u64 = 10_000_000_000;

/// The messages of a topic, sorted by stamp.
#[derive(Debug)]
pub(super) struct Stream<T> {
    pub topic: String,
    /// In ns, increasing.
    pub stamps: Vec<u64>,
    /// One value per stamp.
    pub values: Vec<T>,
}

/// A span of a bag without a clock step, except the pictures.
#[derive(Debug)]
pub(super) struct Recording {
    pub bag: PathBuf,
    pub actions: Stream<Vec<f32>>,
    /// Joints, pose and gripper, if recorded.
    pub states: Vec<Stream<Vec<f32>>>,
    /// Names of an action's values.
    pub action_names: Vec<String>,
    /// Names of the values of all states, concatenated.
    pub state_names: Vec<String>,
    /// Values are the indices of messages within the topic.
    pub cameras: Vec<Stream<u64>>,
    /// Tasks with their start.
    pub instructions: Arc<[(u64, String)]>,
    pub successes: Vec<(u64, bool)>,
    /// Whether any span of the bag has a success.
    pub has_success: bool,
}

/// The part of a recording for an episode.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// In ns, without the end.
    pub time: Range<u64>,
    pub success: Option<bool>,
}

/// A silence of a topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Silence {
    pub topic: String,
    /// Stamps of the messages before and after \[ns\].
    pub time: (u64, u64),
}

impl Recording {
    /// Checks that the spans of a bag have pictures, and actions of one width.
    ///
    /// # Errors
    /// A description of the fault.
    pub fn check(spans: &[Self]) -> Result<(), String> {
        let unsuited = |reason: String| Err(reason);
        let actions = || spans.iter().flat_map(|span| &span.actions.values);
        let Some(first) = actions().next() else {
            return unsuited(format!("expected messages of {ACTION_TOPIC}, got none"));
        };
        if let Some(other) = actions().find(|values| values.len() != first.len()) {
            return unsuited(format!(
                "{ACTION_TOPIC}: expected {} values as in the first, got {}",
                first.len(),
                other.len()
            ));
        }
        if first.is_empty() {
            return unsuited(format!(
                "{ACTION_TOPIC}: expected values, got none ({ACTION})"
            ));
        }
        let cameras = spans.first().map_or(0, |span| span.cameras.len());
        if cameras == 0 {
            return unsuited(
                "expected a camera, .../image_raw or .../image_raw/compressed".to_owned(),
            );
        }
        for number in 0..cameras {
            let mut streams = spans.iter().filter_map(|span| span.cameras.get(number));
            let is_empty = |stream: &Stream<u64>| stream.stamps.is_empty();
            let Some(first) = streams.next().filter(|first| is_empty(first)) else {
                continue;
            };
            if streams.all(is_empty) {
                return unsuited(format!("expected pictures on {}, got none", first.topic));
            }
        }
        Ok(())
    }

    /// The rate of the actions, to the nearest whole number.
    pub fn fps(spans: &[Self], bag: &Path) -> Result<u32, LeRobotError> {
        let mut periods: Vec<u64> = (spans.iter())
            .flat_map(|span| span.actions.periods())
            .collect();
        periods.sort_unstable();
        // The mean of the middle half, which ignores gaps and jitter.
        let quarter = periods.len() / 4;
        let middle = periods
            .get(quarter..periods.len() - quarter)
            .unwrap_or_default();
        let period_ns = middle.iter().sum::<u64>() as f64 / middle.len() as f64;
        let fps = (1e9 / period_ns).round();
        if (1.0..=1000.0).contains(&fps) {
            // Fits: a whole number in range.
            Ok(fps as u32)
        } else {
            Err(LeRobotError::unsuited(
                bag,
                format!(
                    "{ACTION_TOPIC}: expected 1 to 1000 actions per second, got one after {period_ns} ns; set the \
                     rate with --fps"
                ),
            ))
        }
    }

    /// The episodes: the whole recording, or parts that end at messages of `/task/success`, each split at silences. Of a split
    /// part, only the last piece may be a success.
    pub fn parts(&self, silences: &[Silence]) -> Vec<Part> {
        let unsaid = self.has_success.then_some(false);
        let mut parts = Vec::new();
        let mut from = 0;
        for (number, (at, success)) in self.successes.iter().enumerate() {
            let is_last = number + 1 == self.successes.len();
            let to = if is_last { u64::MAX } else { at + 1 };
            parts.push(Part {
                time: from..to,
                success: Some(*success),
            });
            from = to;
        }
        if parts.is_empty() {
            parts.push(Part {
                time: 0..u64::MAX,
                success: unsaid,
            });
        }
        let mut pieces = Vec::new();
        for part in parts {
            let mut from = part.time.start;
            for Silence {
                time: (before, after),
                ..
            } in silences
            {
                if *after <= from || *before >= part.time.end {
                    continue;
                }
                if *before >= from {
                    pieces.push(Part {
                        time: from..before + 1,
                        success: unsaid,
                    });
                }
                from = *after;
            }
            if from < part.time.end {
                pieces.push(Part {
                    time: from..part.time.end,
                    success: part.success,
                });
            }
        }
        pieces
    }

    /// Silences after which the last message is outdated, sorted. A gripper keeps its last command, so its silence does not
    /// count.
    pub fn silences(&self) -> Vec<Silence> {
        let states = self.states.iter();
        let states = states.filter(|stream| stream.topic != GRIPPER_TOPIC);
        let mut all: Vec<Silence> = (self.actions.silences().into_iter())
            .chain(states.flat_map(Stream::silences))
            .chain(self.cameras.iter().flat_map(Stream::silences))
            .collect();
        all.sort_by_key(|silence| silence.time);
        all
    }

    /// The task at a time: the last one before, or the first.
    pub fn instruction(&self, at_ns: u64) -> Option<&str> {
        let before = self
            .instructions
            .iter()
            .rev()
            .find(|(from, _)| *from <= at_ns);
        before
            .or(self.instructions.first())
            .map(|(_, text)| text.as_str())
            .filter(|text| !text.is_empty())
    }

    /// Number of actions and pictures in a part.
    pub fn count(&self, part: &Part) -> (usize, usize) {
        let pictures = self
            .cameras
            .iter()
            .map(|camera| camera.within(&part.time).len());
        (self.actions.within(&part.time).len(), pictures.sum())
    }

    /// The feature of a camera: `/front/image_raw/compressed` becomes `observation.images.front`.
    pub fn feature(topic: &str) -> String {
        let name = ["/image_raw/compressed", "/image_raw", "/compressed"]
            .iter()
            .find_map(|end| topic.strip_suffix(end))
            .unwrap_or(topic);
        let name = name.trim_matches('/').replace('/', "_");
        let name = if name.is_empty() { "camera" } else { &name };
        format!("{IMAGES}{name}")
    }
}

impl<T> Stream<T> {
    /// The stamps within a time span.
    pub fn within(&self, time: &Range<u64>) -> &[u64] {
        let begin = self.stamps.partition_point(|stamp| *stamp < time.start);
        let end = self.stamps.partition_point(|stamp| *stamp < time.end);
        self.stamps.get(begin..end).unwrap_or(&[])
    }

    /// Times between messages \[ns\].
    fn periods(&self) -> impl Iterator<Item = u64> + '_ {
        let pairs = self.stamps.iter().zip(self.stamps.iter().skip(1));
        pairs.map(|(one, next)| next - one)
    }

    fn silences(&self) -> Vec<Silence> {
        let mut periods: Vec<u64> = self.periods().collect();
        periods.sort_unstable();
        // A single picture has no period.
        let median_ns = periods.get(periods.len() / 2).copied().unwrap_or(0);
        let longest_ns = median_ns.saturating_mul(SILENT_PERIODS);
        let longest_ns = longest_ns.clamp(SHORT_NS, LONG_NS);
        let pairs = self.stamps.iter().zip(self.stamps.iter().skip(1));
        pairs
            .filter(|(one, next)| *next - *one > longest_ns)
            .map(|(one, next)| Silence {
                topic: self.topic.clone(),
                time: (*one, *next),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stream(topic: &str, stamps: impl IntoIterator<Item = u64>) -> Stream<Vec<f32>> {
        let stamps: Vec<u64> = stamps.into_iter().map(|ms| ms * 1_000_000).collect();
        Stream {
            topic: topic.into(),
            values: vec![vec![0.0]; stamps.len()],
            stamps,
        }
    }

    fn recording(actions: Stream<Vec<f32>>, gripper: Stream<Vec<f32>>) -> Recording {
        Recording {
            bag: PathBuf::new(),
            actions,
            states: vec![gripper],
            action_names: Vec::new(),
            state_names: Vec::new(),
            cameras: Vec::new(),
            instructions: Arc::new([]),
            successes: vec![(9_000_000_000, true)],
            has_success: true,
        }
    }

    #[test]
    fn silent_topic_splits_unlike_a_silent_gripper() {
        let steady = |from: u64, to: u64| (from..to).step_by(100);
        let actions = stream(ACTION_TOPIC, steady(0, 2000).chain(steady(5000, 9000)));
        let recording = recording(actions, stream(GRIPPER_TOPIC, [0, 8000]));
        let silences = recording.silences();
        let ms = |ms: u64| ms * 1_000_000;
        let expected = Silence {
            topic: ACTION_TOPIC.into(),
            time: (ms(1900), ms(5000)),
        };
        assert_eq!(silences, [expected]);
        let parts = recording.parts(&silences);
        let times: Vec<_> = parts.iter().map(|part| part.time.clone()).collect();
        assert_eq!(times, [0..ms(1900) + 1, ms(5000)..u64::MAX]);
        let successes: Vec<_> = parts.iter().map(|part| part.success).collect();
        assert_eq!(successes, [Some(false), Some(true)]);
    }

    #[test]
    fn slow_topic_is_not_silent() {
        let slow = stream(ACTION_TOPIC, (0..10).map(|number| number * 900));
        assert_eq!(slow.silences(), []);
        let jittery = stream(ACTION_TOPIC, [0, 400, 800, 1200, 4000, 4400, 4800]);
        assert_eq!(jittery.silences(), []);
    }

    proptest! {
        /// Parts do not overlap, exclude silences, and include all other messages.
        #[test]
        fn parts_exclude_only_silences(
            steps in prop::collection::vec(prop::sample::select(vec![100u64, 110, 5_000, 20_000]), 2..60),
        ) {
            let stamps: Vec<u64> = steps.iter().scan(0, |at, step| { *at += step; Some(*at) }).collect();
            let actions = stream(ACTION_TOPIC, stamps);
            let recording = recording(actions, stream(GRIPPER_TOPIC, []));
            let silences = recording.silences();
            let parts = recording.parts(&silences);
            for pair in parts.windows(2) {
                prop_assert!(pair[0].time.end <= pair[1].time.start);
            }
            for part in &parts {
                for Silence { time: (before, after), .. } in &silences {
                    prop_assert!(part.time.end <= before + 1 || part.time.start >= *after);
                }
            }
            let kept: usize = parts.iter().map(|part| recording.count(part).0).sum();
            prop_assert_eq!(kept, recording.actions.stamps.len());
        }
    }
}
