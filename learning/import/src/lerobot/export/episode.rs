use std::ops::Range;

use super::recording::{Part, Recording, Stream};
use crate::lerobot::{LeRobotError, topics::frame_ns};

/// The messages of an episode's frames.
#[derive(Debug)]
pub(super) struct Episode {
    pub start_ns: u64,
    /// Actions by frame.
    pub actions: Picks,
    /// Of each state topic.
    pub states: Vec<Picks>,
    /// Of each camera.
    pub cameras: Vec<Picks>,
    /// Task by frame.
    pub tasks: Vec<String>,
    pub success: Option<bool>,
}

/// The message of a topic for each frame, in order; frames may share a message.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Picks {
    pub topic: String,
    pub numbers: Vec<usize>,
    /// Number of frames whose message is further than half a frame.
    pub repeated: u64,
    /// Number of messages, between the first and the last, of no frame.
    pub skipped: u64,
}

impl Episode {
    pub fn sample(
        recording: &Recording,
        part: &Part,
        fps: u32,
        default_task: &str,
    ) -> Result<Self, LeRobotError> {
        let bounds = [first_and_last(&recording.actions, &part.time)]
            .into_iter()
            .chain(
                recording
                    .states
                    .iter()
                    .map(|stream| first_and_last(stream, &part.time)),
            )
            .chain(
                recording
                    .cameras
                    .iter()
                    .map(|stream| first_and_last(stream, &part.time)),
            );
        let mut time = (0, u64::MAX);
        for found in bounds {
            let (topic, first_last) = found;
            let (first, last) = first_last.ok_or_else(|| {
                LeRobotError::unsuited(
                    &recording.bag,
                    format!(
                        "{topic}: no message in the episode from {} ns",
                        part.time.start
                    ),
                )
            })?;
            time = (time.0.max(first), time.1.min(last));
        }
        let (start_ns, end_ns) = time;
        let span_ns = end_ns.checked_sub(start_ns).ok_or_else(|| {
            LeRobotError::unsuited(
                &recording.bag,
                format!("expected a time at which every topic has a message, got none: {start_ns} ns to {end_ns} ns"),
            )
        })?;
        // The last frame may be a quarter of a period after the last message: clocks are not synchronised.
        let frames = (span_ns as f64 * f64::from(fps) / 1e9 + 0.25).floor() as u64 + 1;
        let times: Vec<u64> = (0..frames)
            .map(|frame| start_ns + frame_ns(frame, f64::from(fps)))
            .collect();
        let half_ns = 500_000_000 / u64::from(fps);
        let task = |at: &u64| {
            recording
                .instruction(*at)
                .unwrap_or(default_task)
                .to_owned()
        };
        Ok(Self {
            start_ns,
            actions: pick_nearest(&recording.actions, &times, half_ns),
            states: recording
                .states
                .iter()
                .map(|s| pick_nearest(s, &times, half_ns))
                .collect(),
            cameras: recording
                .cameras
                .iter()
                .map(|s| pick_nearest(s, &times, half_ns))
                .collect(),
            tasks: times.iter().map(task).collect(),
            success: part.success,
        })
    }

    pub fn frames(&self) -> usize {
        self.actions.numbers.len()
    }

    /// Describes topics whose times do not fit the rate.
    pub fn resampled(&self) -> Vec<String> {
        let all = [&self.actions]
            .into_iter()
            .chain(&self.states)
            .chain(&self.cameras);
        all.filter(|picks| picks.repeated > 0 || picks.skipped > 0)
            .map(|picks| {
                format!(
                    "{}: {} of {} frames repeat a message, {} messages are not used",
                    picks.topic,
                    picks.repeated,
                    picks.numbers.len(),
                    picks.skipped
                )
            })
            .collect()
    }
}

/// First and last stamp of a topic within a time span.
fn first_and_last<'a, T>(
    stream: &'a Stream<T>,
    time: &Range<u64>,
) -> (&'a str, Option<(u64, u64)>) {
    let within = stream.within(time);
    let bounds = within.first().copied().zip(within.last().copied());
    (&stream.topic, bounds)
}

/// Finds the nearest message for each time; times, stamps and results increase.
fn pick_nearest<T>(stream: &Stream<T>, times: &[u64], half_ns: u64) -> Picks {
    let distance = |number: usize, time: u64| {
        stream
            .stamps
            .get(number)
            .map_or(u64::MAX, |stamp| stamp.abs_diff(time))
    };
    let mut picks = Picks {
        topic: stream.topic.clone(),
        numbers: Vec::with_capacity(times.len()),
        repeated: 0,
        skipped: 0,
    };
    for time in times {
        let after = stream.stamps.partition_point(|stamp| stamp < time);
        let before = after.saturating_sub(1);
        let nearest = if distance(before, *time) <= distance(after, *time) {
            before
        } else {
            after
        };
        if distance(nearest, *time) > half_ns {
            picks.repeated += 1;
        }
        if let Some(last) = picks.numbers.last() {
            picks.skipped += (nearest - last).saturating_sub(1) as u64;
        }
        picks.numbers.push(nearest);
    }
    picks
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stream(stamps: Vec<u64>) -> Stream<()> {
        Stream {
            topic: "/x".into(),
            values: vec![(); stamps.len()],
            stamps,
        }
    }

    #[test]
    fn frames_take_the_nearest_message() {
        let picks = pick_nearest(
            &stream(vec![0, 90, 210, 290, 300, 700]),
            &[0, 100, 200, 300, 400],
            50,
        );
        assert_eq!(picks.numbers, [0, 1, 2, 4, 4]);
        assert_eq!((picks.repeated, picks.skipped), (1, 1));
    }

    proptest! {
        #[test]
        fn no_message_is_nearer_than_the_one_taken(
            steps in prop::collection::vec(1u64..1000, 1..50), times in prop::collection::vec(0u64..2000, 1..50),
        ) {
            let stamps: Vec<u64> = steps.iter().scan(0, |at, step| { *at += step; Some(*at) }).collect();
            let times: Vec<u64> = times.iter().scan(0, |at, step| { *at += step; Some(*at) }).collect();
            let picks = pick_nearest(&stream(stamps.clone()), &times, 100);
            prop_assert!(picks.numbers.is_sorted());
            for (number, time) in picks.numbers.iter().zip(&times) {
                let nearest = stamps.iter().map(|stamp| stamp.abs_diff(*time)).min().unwrap();
                prop_assert_eq!(stamps[*number].abs_diff(*time), nearest);
            }
        }
    }
}
