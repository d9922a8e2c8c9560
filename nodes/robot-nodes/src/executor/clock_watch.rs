//! A watchdog for the node's clock, by the monotonic clock.

use std::time::{Duration, Instant};

use super::{Hold, Moment};

/// A clock that is ahead by more than this between two commands has jumped \[ns\].
const JUMP_AHEAD_NS: i64 = 500_000_000;

/// Whether the node's clock advances.
#[derive(Clone, Debug)]
pub struct ClockWatch {
    timeout: Duration,
    /// The latest time of the clock \[ns\], and when it was read.
    newest: Option<(i64, Instant)>,
    last: Option<Moment>,
}

impl ClockWatch {
    /// A watchdog for a clock that has to advance at least every `timeout` of the monotonic clock.
    pub fn new(timeout: Duration) -> Self {
        Self {
            timeout,
            newest: None,
            last: None,
        }
    }

    /// How long a clock may stand still, at most `longest`, so that the arm is at rest within `max_age` of the clock's
    /// stop. The watchdog sees that up to a command period late, and the arm then takes `stop_within`.
    pub(super) fn timeout_for(
        longest: Duration,
        max_age: Duration,
        stop_within: Duration,
        period: Duration,
    ) -> Duration {
        let left = max_age.saturating_sub(stop_within).saturating_sub(period);
        // A shorter one would hold the arm between two commands of a clock that advances.
        longest.min(left.max(period))
    }

    /// Takes the present. A clock that jumps to and fro does not advance.
    pub(super) fn see(&mut self, now: Moment) {
        if self
            .newest
            .is_none_or(|(newest_ns, _)| now.stamp_ns > newest_ns)
        {
            self.newest = Some((now.stamp_ns, now.real));
        }
    }

    /// Takes the present at a command; returns the jump of the clock since the last one \[s\].
    pub(super) fn leap_s(&mut self, now: Moment) -> Option<f64> {
        let last = self.last.replace(now)?;
        let passed = now.at.saturating_duration_since(last.at);
        // 64 bits of nanoseconds hold 292 years.
        let passed_ns = i64::try_from(passed.as_nanos()).unwrap_or(i64::MAX);
        let leap_ns = now
            .stamp_ns
            .saturating_sub(last.stamp_ns)
            .saturating_sub(passed_ns);
        (leap_ns > JUMP_AHEAD_NS && last.stamp_ns > 0).then_some(leap_ns as f64 / 1e9)
    }

    /// The clock was set back.
    pub(super) fn reset(&mut self) {
        self.newest = None;
    }

    /// Checks that the clock advances.
    ///
    /// # Errors
    /// [`Hold::ClockStopped`].
    pub(super) fn check(&self, now: Moment) -> Result<(), Hold> {
        let silent = self
            .newest
            .map(|(_, since)| now.real.saturating_duration_since(since));
        match silent {
            Some(silent) if silent >= self.timeout => Err(Hold::ClockStopped {
                timeout_s: self.timeout.as_secs_f64(),
            }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_stops_or_oscillates_does_not_advance() {
        let (begin, timeout) = (Instant::now(), Duration::from_secs(1));
        let mut watch = ClockWatch::new(timeout);
        let now = |ms: u64, stamp_ns| Moment::real(begin + Duration::from_millis(ms), stamp_ns);
        assert_eq!(watch.check(now(5_000, 0)), Ok(()));
        for (ms, stamp_ns) in [(0, 70), (500, 40), (999, 70)] {
            watch.see(now(ms, stamp_ns));
            assert_eq!(watch.check(now(ms, stamp_ns)), Ok(()));
        }
        watch.see(now(1_000, 50));
        assert!(watch.check(now(1_000, 50)).is_err());
        watch.see(now(1_100, 71));
        assert_eq!(watch.check(now(1_100, 71)), Ok(()));
    }

    #[test]
    fn a_jump_ahead_is_measured() {
        let begin = Instant::now();
        let mut watch = ClockWatch::new(Duration::from_secs(1));
        let now = |ms: u64, stamp_s: i64| {
            Moment::real(begin + Duration::from_millis(ms), stamp_s * 1_000_000_000)
        };
        assert_eq!(watch.leap_s(now(0, 100)), None);
        assert_eq!(watch.leap_s(now(1_000, 101)), None);
        let leap = watch.leap_s(now(1_500, 111)).unwrap();
        assert!((leap - 9.5).abs() < 1e-9, "{leap}");
        assert_eq!(watch.leap_s(now(1_600, 20)), None);
    }
}
