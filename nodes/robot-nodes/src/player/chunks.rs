//! The bag's next actions, as a policy would publish them.

use thiserror::Error;
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
    wm_msgs::{Action, ActionChunk},
};

/// The reason why a bag's actions cannot become chunks.
#[derive(Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum ChunkError {
    /// Fewer than two actions have no period.
    #[error("the bag has {0} action(s); at least 2 are needed to determine their period")]
    TooFew(usize),
    /// The actions are not in the order of time.
    #[error("the bag's actions have no positive period: their median distance is {0} ns")]
    Period(i64),
}

/// Chunks of a bag's actions, in order. Each chunk begins with another action.
///
/// The stamp of a chunk is that of its first action. Chunks overlap: if a frame arrives earlier than its chunk, the
/// previous chunk contains its actions.
#[derive(Clone, Debug)]
pub struct ActionChunks {
    /// Log times \[ns\], in order, and actions.
    actions: Vec<(u64, Action)>,
    period_ns: i64,
    length: usize,
}

impl ActionChunks {
    /// Chunks of at most `length` actions. Each action has its log time \[ns\], and they are in the order of these.
    ///
    /// # Errors
    /// There are fewer than two actions, or their stamps do not increase.
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

    /// The chunk that begins with the first action at or after this log time; `None` after the last action. `map` converts
    /// stamps \[ns\] to the time of the replay. `rate` is the playback rate: seconds of the bag per second.
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
            // Chunks are not longer than the bag.
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

    /// An action whose log time is 5 ns after its stamp.
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
        // The third action is late, but the chunk's times follow the period.
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
