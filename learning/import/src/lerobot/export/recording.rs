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

/// A topic may be silent for so many of its periods \[1\] ...
const MOST_PERIODS: u64 = 10;
/// ... but in any case for the first and never for more than the second \[ns\]. The audit's bounds of a dropped frame, and
/// the bag's of a gap.
const SHORT_NS: u64 = 1_000_000_000;
const LONG_NS: u64 = 10_000_000_000;

/// The messages of a topic, in the order of their stamps.
#[derive(Debug)]
pub(super) struct Stream<T> {
    pub topic: String,
    /// In ns, increasing.
    pub stamps: Vec<u64>,
    /// One a stamp.
    pub values: Vec<T>,
}

/// A span of a bag in which the clock runs on, but for the pictures themselves.
#[derive(Debug)]
pub(super) struct Recording {
    pub bag: PathBuf,
    pub actions: Stream<Vec<f32>>,
    /// Joints, pose and gripper, those that the bag has.
    pub states: Vec<Stream<Vec<f32>>>,
    /// Names of an action's values.
    pub action_names: Vec<String>,
    /// Names of the values of all states, one after the other.
    pub state_names: Vec<String>,
    /// Each value is the message's number within its topic in the bag.
    pub cameras: Vec<Stream<u64>>,
    /// From when on each task of the bag holds.
    pub instructions: Arc<[(u64, String)]>,
    pub successes: Vec<(u64, bool)>,
    /// Whether any span of the bag has a success.
    pub has_success: bool,
}

/// An episode's part of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// In ns; the end is left out.
    pub time: Range<u64>,
    pub success: Option<bool>,
}

/// A time in which a topic is silent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Silence {
    pub topic: String,
    /// Stamps of the message before and of the one after \[ns\].
    pub time: (u64, u64),
}

impl Recording {
    /// Expects actions of one width and pictures in the spans of a bag.
    ///
    /// # Errors
    /// In words.
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

    /// The rate of the actions in the spans of a bag, to the nearest whole number.
    pub fn fps(spans: &[Self], bag: &Path) -> Result<u32, LeRobotError> {
        let mut periods: Vec<u64> = (spans.iter())
            .flat_map(|span| span.actions.periods())
            .collect();
        periods.sort_unstable();
        // The mean of the middle half: neither a gap nor a clock that trembles moves it.
        let quarter = periods.len() / 4;
        let middle = periods
            .get(quarter..periods.len() - quarter)
            .unwrap_or_default();
        let period_ns = middle.iter().sum::<u64>() as f64 / middle.len() as f64;
        let fps = (1e9 / period_ns).round();
        if (1.0..=1000.0).contains(&fps) {
            // Whole, and in range.
            Ok(fps as u32)
        } else {
            Err(LeRobotError::unsuited(
                bag,
                format!(
                    "{ACTION_TOPIC}: expected 1 to 1000 actions per second, got one after {period_ns} ns; give the \
                     rate with --fps"
                ),
            ))
        }
    }

    /// The episodes: all of it, or the parts that several messages of `/task/success` end, each split where a topic is
    /// silent. Of a split part only the last piece may be a success.
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

    /// When topics are silent for so long that no message stands for the time, in order. A gripper holds what it was last
    /// commanded: its silence is none.
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

    /// The task that holds at a time: the last one before, or the first of all.
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

    /// Actions and pictures with stamps in a part.
    pub fn count(&self, part: &Part) -> (usize, usize) {
        let pictures = self
            .cameras
            .iter()
            .map(|camera| camera.within(&part.time).len());
        (self.actions.within(&part.time).len(), pictures.sum())
    }

    /// Feature of a camera: `/front/image_raw/compressed` becomes `observation.images.front`.
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
    /// The stamps within a time.
    pub fn within(&self, time: &Range<u64>) -> &[u64] {
        let begin = self.stamps.partition_point(|stamp| *stamp < time.start);
        let end = self.stamps.partition_point(|stamp| *stamp < time.end);
        self.stamps.get(begin..end).unwrap_or(&[])
    }

    /// The time from each message to the next \[ns\].
    fn periods(&self) -> impl Iterator<Item = u64> + '_ {
        let pairs = self.stamps.iter().zip(self.stamps.iter().skip(1));
        pairs.map(|(one, next)| next - one)
    }

    fn silences(&self) -> Vec<Silence> {
        let mut periods: Vec<u64> = self.periods().collect();
        periods.sort_unstable();
        let median_ns = periods.get(periods.len() / 2).copied().unwrap_or(0);
        let longest_ns = median_ns.saturating_mul(MOST_PERIODS);
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
    fn a_silent_topic_splits_and_a_silent_gripper_does_not() {
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
    fn a_slow_topic_is_not_silent() {
        let slow = stream(ACTION_TOPIC, (0..10).map(|number| number * 900));
        assert_eq!(slow.silences(), []);
        let jittery = stream(ACTION_TOPIC, [0, 400, 800, 1200, 4000, 4400, 4800]);
        assert_eq!(jittery.silences(), []);
    }

    proptest! {
        /// Parts neither overlap nor reach into a silence, and no message outside the silences is lost.
        #[test]
        fn parts_leave_out_the_silences_alone(
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
