//! Messages per second.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// The rate is taken over this time, so that 5 Hz does not read 4 or 6 from one second to the next.
const WINDOW: Duration = Duration::from_secs(10);

/// Counts events and computes their rate.
#[derive(Debug, Default)]
pub(super) struct Rate {
    total: u64,
    /// The total at past reports, oldest first; the first entry is the first event's own.
    marks: VecDeque<(Instant, u64)>,
}

impl Rate {
    pub(super) fn count(&mut self, now: Instant) {
        if self.marks.is_empty() {
            self.marks.push_back((now, 0));
        }
        self.total += 1;
    }

    pub(super) fn total(&self) -> u64 {
        self.total
    }

    /// Events per second over the last ten seconds, or since the first event; records the total for later calls.
    pub(super) fn per_second(&mut self, now: Instant) -> f64 {
        let is_old = |(then, _): &(Instant, u64)| now.saturating_duration_since(*then) > WINDOW;
        // keep the newest of the expired marks: it begins the window
        while self.marks.get(1).is_some_and(is_old) {
            self.marks.pop_front();
        }
        let rate = match self.marks.front() {
            Some((then, before)) if now > *then => {
                // a count below 2^53 in practice
                (self.total - before) as f64 / now.saturating_duration_since(*then).as_secs_f64()
            }
            _ => 0.0,
        };
        self.marks.push_back((now, self.total));
        rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_rate_is_found_and_forgotten_when_it_ends() {
        let start = Instant::now();
        let mut rate = Rate::default();
        let mut measured = Vec::new();
        for tenth in 0..400u64 {
            let now = start + Duration::from_millis(100 * tenth);
            if tenth % 2 == 0 && tenth < 200 {
                rate.count(now);
            }
            if tenth % 10 == 9 {
                measured.push(rate.per_second(now));
            }
        }
        let steady = measured.get(15).copied().unwrap();
        assert!((steady - 5.0).abs() < 0.3, "{steady}");
        assert_eq!(measured.last().copied(), Some(0.0));
        assert!(rate.marks.len() < 15, "memory is bounded");
        assert_eq!(rate.total(), 100);
    }
}
