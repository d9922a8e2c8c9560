use std::ops::Range;

use super::recording::{Part, Recording, Stream};
use crate::lerobot::{LeRobotError, topics::frame_ns};

/// The messages that an episode's frames take.
#[derive(Debug)]
pub(super) struct Episode {
    pub start_ns: u64,
    /// Numbers of the actions, one a frame.
    pub actions: Picks,
    /// The same of each state.
    pub states: Vec<Picks>,
    /// The same of each camera.
    pub cameras: Vec<Picks>,
    /// The task of each frame.
    pub tasks: Vec<String>,
    pub success: Option<bool>,
}

/// The messages of a topic that the frames take, one a frame, in order; a message may be taken more than once.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Picks {
    pub topic: String,
    pub numbers: Vec<usize>,
    /// Frames whose message is further away than half a frame.
    pub repeated: u64,
    /// Messages between the first and the last that no frame takes.
    pub skipped: u64,
}

impl Episode {
    pub fn sample(
        recording: &Recording,
        part: &Part,
        fps: u32,
        default_task: &str,
    ) -> Result<Self, LeRobotError> {
        let bounds = [bound(&recording.actions, &part.time)]
            .into_iter()
            .chain(
                recording
                    .states
                    .iter()
                    .map(|stream| bound(stream, &part.time)),
            )
            .chain(
                recording
                    .cameras
                    .iter()
                    .map(|stream| bound(stream, &part.time)),
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
                format!("there is no time at which every topic has a message: {start_ns} ns to {end_ns} ns"),
            )
        })?;
        // The last frame may lie a quarter of a period past the last message, as clocks that are not locked have it.
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
            actions: pick(&recording.actions, &times, half_ns),
            states: recording
                .states
                .iter()
                .map(|s| pick(s, &times, half_ns))
                .collect(),
            cameras: recording
                .cameras
                .iter()
                .map(|s| pick(s, &times, half_ns))
                .collect(),
            tasks: times.iter().map(task).collect(),
            success: part.success,
        })
    }

    pub fn frames(&self) -> usize {
        self.actions.numbers.len()
    }

    /// What the bag's times did not allow, in words.
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

/// First and last stamp of a topic within a time.
fn bound<'a, T>(stream: &'a Stream<T>, time: &Range<u64>) -> (&'a str, Option<(u64, u64)>) {
    let within = stream.within(time);
    let bounds = within.first().copied().zip(within.last().copied());
    (&stream.topic, bounds)
}

/// The message nearest to each time. Times and stamps increase, and so do the numbers.
fn pick<T>(stream: &Stream<T>, times: &[u64], half_ns: u64) -> Picks {
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
        let picks = pick(
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
            let picks = pick(&stream(stamps.clone()), &times, 100);
            prop_assert!(picks.numbers.is_sorted());
            for (number, time) in picks.numbers.iter().zip(&times) {
                let nearest = stamps.iter().map(|stamp| stamp.abs_diff(*time)).min().unwrap();
                prop_assert_eq!(stamps[*number].abs_diff(*time), nearest);
            }
        }
    }
}
