//! The buffer for the predictions of a running rollout.

use std::time::{Duration, Instant};

/// Length of the queue of predictions: two rollouts of eight, since predictions arrive faster than one by one.
pub(super) const WAITING: usize = 16;
/// A prediction stays in the buffer at most this long: longer than a fast rollout takes, and too short to be seen in a
/// picture that is half a second ahead.
const LONGEST: Duration = Duration::from_millis(100);
/// Capacity of the buffer. Its predictions enter the queue together, and the queue has room for them twice.
const MOST: usize = WAITING / 2;

/// Holds a rollout's predictions until the rollout ends, because decoding takes processor time from the remaining steps.
/// Slow predictions are released after a tenth of a second.
#[derive(Debug)]
pub(super) struct RolloutBuffer<T> {
    predictions: Vec<T>,
    /// Stamp of the rollout's observation \[ns\].
    observed_ns: i64,
    since: Option<Instant>,
}

impl<T> RolloutBuffer<T> {
    pub(super) fn new() -> Self {
        Self {
            predictions: Vec::new(),
            observed_ns: 0,
            since: None,
        }
    }

    /// Adds a prediction that was received `now`, from the observation stamped `observed_ns`. Returns the predictions to
    /// decode.
    pub(super) fn add(
        &mut self,
        prediction: T,
        (observed_ns, is_last): (i64, bool),
        now: Instant,
    ) -> Vec<T> {
        // The last prediction of the previous rollout was lost.
        let mut ready = match self.observed_ns == observed_ns {
            true => Vec::new(),
            false => self.release(),
        };
        self.observed_ns = observed_ns;
        self.since.get_or_insert(now);
        self.predictions.push(prediction);
        if is_last || self.predictions.len() >= MOST {
            ready.append(&mut self.release());
        }
        ready
    }

    /// When [`Self::release`] is due; `None` if the buffer is empty.
    pub(super) fn due(&self) -> Option<Instant> {
        self.since.map(|since| since + LONGEST)
    }

    /// Empties the buffer, and returns its predictions.
    pub(super) fn release(&mut self) -> Vec<T> {
        self.since = None;
        std::mem::take(&mut self.predictions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffer_holds_rollout_until_last_step() {
        let (mut buffer, now) = (RolloutBuffer::new(), Instant::now());
        assert_eq!(buffer.due(), None);
        for step in 1..4 {
            assert!(buffer.add(step, (7, false), now).is_empty());
        }
        assert_eq!(buffer.due(), Some(now + LONGEST));
        assert_eq!(buffer.add(4, (7, true), now), [1, 2, 3, 4]);
        assert_eq!(buffer.due(), None);
    }

    #[test]
    fn next_rollout_releases_the_previous_one() {
        let (mut buffer, now) = (RolloutBuffer::new(), Instant::now());
        buffer.add(1, (7, false), now);
        assert_eq!(buffer.add(2, (8, false), now + LONGEST), [1]);
        assert_eq!(buffer.due(), Some(now + 2 * LONGEST));
        assert_eq!(buffer.release(), [2]);
    }

    #[test]
    fn buffer_never_exceeds_half_the_queue() {
        let (mut buffer, now) = (RolloutBuffer::new(), Instant::now());
        let ready: Vec<usize> = (1..=2 * MOST)
            .flat_map(|step| buffer.add(step, (7, step == 2 * MOST), now))
            .collect();
        assert_eq!(ready, (1..=2 * MOST).collect::<Vec<_>>());
        let handed_over = (1..=MOST).map(|step| buffer.add(step, (8, false), now).len());
        assert_eq!(handed_over.max(), Some(MOST));
    }
}
