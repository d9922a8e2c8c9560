//! Predictions of a rollout that is still under way.

use std::time::{Duration, Instant};

/// How long predictions are held at most: longer than a fast rollout takes from its first step to its last, and too short
/// to be seen in a picture that is half a second ahead.
const LONGEST: Duration = Duration::from_millis(100);
/// As many as are held at most: they are all handed over at once, to a queue of twice that length.
const MOST: usize = super::node::WAITING / 2;

/// Holds a rollout's predictions until it is over, since decoding them takes the processor from the steps that are still
/// being predicted. Where they come slowly, none is held for long.
#[derive(Debug)]
pub(super) struct Held<T> {
    predictions: Vec<T>,
    /// Of the rollout's observation \[ns\].
    observed_ns: i64,
    since: Option<Instant>,
}

impl<T> Held<T> {
    pub(super) fn new() -> Self {
        Self {
            predictions: Vec::new(),
            observed_ns: 0,
            since: None,
        }
    }

    /// Adds a prediction from the observation of `observed_ns` that came `now`; gives those whose time has come.
    pub(super) fn add(
        &mut self,
        prediction: T,
        (observed_ns, is_last): (i64, bool),
        now: Instant,
    ) -> Vec<T> {
        // The last of the rollout before is lost.
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

    /// When [`Self::release`] is due; none where nothing is held.
    pub(super) fn due(&self) -> Option<Instant> {
        self.since.map(|since| since + LONGEST)
    }

    /// Gives all that is held.
    pub(super) fn release(&mut self) -> Vec<T> {
        self.since = None;
        std::mem::take(&mut self.predictions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rollout_is_held_until_its_last_step_comes() {
        let (mut held, now) = (Held::new(), Instant::now());
        assert_eq!(held.due(), None);
        for step in 1..4 {
            assert!(held.add(step, (7, false), now).is_empty());
        }
        assert_eq!(held.due(), Some(now + LONGEST));
        assert_eq!(held.add(4, (7, true), now), [1, 2, 3, 4]);
        assert_eq!(held.due(), None);
    }

    #[test]
    fn what_is_left_of_a_rollout_goes_when_the_next_begins() {
        let (mut held, now) = (Held::new(), Instant::now());
        held.add(1, (7, false), now);
        assert_eq!(held.add(2, (8, false), now + LONGEST), [1]);
        assert_eq!(held.due(), Some(now + 2 * LONGEST));
        assert_eq!(held.release(), [2]);
    }

    #[test]
    fn no_more_are_held_than_the_queue_takes() {
        let (mut held, now) = (Held::new(), Instant::now());
        let ready: Vec<usize> = (1..=2 * MOST)
            .flat_map(|step| held.add(step, (7, step == 2 * MOST), now))
            .collect();
        assert_eq!(ready, (1..=2 * MOST).collect::<Vec<_>>());
        let handed_over = (1..=MOST).map(|step| held.add(step, (8, false), now).len());
        assert_eq!(handed_over.max(), Some(MOST));
    }
}
