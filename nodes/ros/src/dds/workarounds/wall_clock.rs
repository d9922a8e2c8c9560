//! Detects a wall clock that was set back. rustdds 0.15.1 sorts received samples by the wall clock: its best-effort readers
//! skip everything that arrives within the repeated time.

use std::time::{Duration, Instant};

/// Best-effort readers may lose this much anyway.
const TOLERATED_STEP: Duration = Duration::from_millis(500);

/// Compares the wall clock with the monotonic clock.
pub(in crate::dds) struct WallClock {
    last: (Instant, i64),
}

impl WallClock {
    pub(in crate::dds) const fn new(now: (Instant, i64)) -> Self {
        Self { last: now }
    }

    /// How far the wall clock was set back since the last call, if further than tolerated.
    pub(in crate::dds) fn step(&mut self, now: (Instant, i64)) -> Option<Duration> {
        let passed = now.0.saturating_duration_since(self.last.0).as_nanos();
        // a process does not run for 2^127 ns
        let expected = i128::from(self.last.1) + i128::try_from(passed).unwrap_or(i128::MAX);
        self.last = now;
        let back = u64::try_from(expected - i128::from(now.1)).ok()?;
        let back = Duration::from_nanos(back);
        (back > TOLERATED_STEP).then_some(back)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_step_back_is_reported_and_only_once() {
        const SECOND: i64 = 1_000_000_000;
        let start = Instant::now();
        let mut clock = WallClock::new((start, 100 * SECOND));
        let mut step =
            |after: u64, wall: i64| clock.step((start + Duration::from_secs(after), wall));
        assert_eq!(step(1, 101 * SECOND), None);
        assert_eq!(step(2, 900 * SECOND), None, "forward");
        assert_eq!(step(3, 901 * SECOND - SECOND / 10), None, "slewed");
        let thirty = Duration::from_millis(30_900);
        assert_eq!(step(4, 871 * SECOND), Some(thirty));
        assert_eq!(step(5, 872 * SECOND), None, "reported once");
    }
}
