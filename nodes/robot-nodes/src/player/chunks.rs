//! The bag's next actions, as a policy would publish them.

use thiserror::Error;
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
    wm_msgs::{Action, ActionChunk},
};

/// Why a bag's actions make no chunks.
#[derive(Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum ChunkError {
    /// One action has no period.
    #[error("the bag has {0} action(s); at least 2 are needed to determine their period")]
    TooFew(usize),
    /// Actions that do not come one after the other.
    #[error("the bag's actions have no positive period: their median distance is {0} ns")]
    Period(i64),
}

/// A bag's actions in order, handed out in chunks: the one at an action begins with that action.
///
/// The chunk of an action has that action's stamp, so that it says what is done from this moment on; chunks
/// overlap, so that a frame that overtakes its chunk is served by the one before.
#[derive(Clone, Debug)]
pub struct ActionChunks {
    /// Log times \[ns\], in order, and actions.
    actions: Vec<(u64, Action)>,
    period_ns: i64,
    length: usize,
}

impl ActionChunks {
    /// Chunks of at most `length` of these actions, each with its log time \[ns\], in whose order they are.
    ///
    /// # Errors
    /// Where there are fewer than two, or their stamps do not grow.
    pub fn new(actions: Vec<(u64, Action)>, length: usize) -> Result<Self, ChunkError> {
        let stamps = actions
            .iter()
            .map(|(_, action)| action.header.stamp.to_nanos());
        let mut distances: Vec<i64> = stamps
            .clone()
            .zip(stamps.skip(1))
            .map(|(one, next)| next - one)
            .collect();
        distances.sort_unstable();
        let Some(&period_ns) = distances.get(distances.len() / 2) else {
            return Err(ChunkError::TooFew(actions.len()));
        };
        if period_ns <= 0 {
            return Err(ChunkError::Period(period_ns));
        }
        Ok(Self {
            actions,
            period_ns,
            length,
        })
    }

    /// The chunk that begins with the first action at or after this log time; none past the last action. `map` moves
    /// stamps \[ns\] to the time of the replay, and `rate` is the bag's seconds in a second there.
    #[must_use]
    pub fn chunk(
        &self,
        log_time_ns: u64,
        rate: f64,
        map: impl Fn(i64) -> i64,
    ) -> Option<ActionChunk> {
        let index = self
            .actions
            .partition_point(|(logged_ns, _)| *logged_ns < log_time_ns);
        let (_, first) = self.actions.get(index)?;
        let stamp_ns = map(first.header.stamp.to_nanos());
        let period_ns = (self.period_ns as f64 / rate).round() as i64;
        let coming = self
            .actions
            .iter()
            .skip(index)
            .take(self.length)
            .enumerate();
        let actions = coming.map(|(step, (_, action))| {
            // a chunk has no more actions than the bag
            let stamp =
                Time::from_nanos(stamp_ns.saturating_add(period_ns.saturating_mul(step as i64)));
            Action {
                header: Header {
                    stamp,
                    ..action.header.clone()
                },
                values: action.values.clone(),
            }
        });
        Some(ActionChunk {
            header: Header {
                stamp: Time::from_nanos(stamp_ns),
                frame_id: first.header.frame_id.clone(),
            },
            period: Duration::from_nanos(period_ns),
            actions: actions.collect(),
            ..ActionChunk::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Logged 5 ns after its stamp.
    fn action(stamp_ns: i64, value: f32) -> (u64, Action) {
        let header = Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: "base".to_owned(),
        };
        let action = Action {
            header,
            values: vec![value; 7],
        };
        (stamp_ns as u64 + 5, action)
    }

    #[test]
    fn a_chunk_begins_with_its_action_and_ends_with_the_bag() {
        // the third is late: the chunk's times are those of the period all the same
        let actions = vec![
            action(1000, 0.0),
            action(1200, 1.0),
            action(1430, 2.0),
            action(1600, 3.0),
        ];
        let chunks = ActionChunks::new(actions, 3).unwrap();
        let chunk = chunks.chunk(1006, 1.0, |stamp| stamp + 7).unwrap();
        assert_eq!(
            (chunk.header.stamp.to_nanos(), chunk.period.to_nanos()),
            (1207, 200)
        );
        let entries: Vec<_> = chunk
            .actions
            .iter()
            .map(|a| (a.header.stamp.to_nanos(), a.values[0]))
            .collect();
        assert_eq!(entries, [(1207, 1.0), (1407, 2.0), (1607, 3.0)]);
        assert_eq!(
            chunks
                .chunk(1605, 1.0, |stamp| stamp)
                .unwrap()
                .actions
                .len(),
            1
        );
        assert_eq!(chunks.chunk(1606, 1.0, |stamp| stamp), None);
        assert_eq!(
            chunks
                .chunk(1005, 2.0, |stamp| stamp)
                .unwrap()
                .period
                .to_nanos(),
            100
        );
    }

    #[test]
    fn actions_without_a_period_are_refused() {
        assert_eq!(
            ActionChunks::new(vec![action(1, 0.0)], 3).unwrap_err(),
            ChunkError::TooFew(1)
        );
        let same = vec![action(1, 0.0), action(1, 0.0)];
        assert_eq!(
            ActionChunks::new(same, 3).unwrap_err(),
            ChunkError::Period(0)
        );
    }
}
