//! A moment, by all clocks that commands depend on.

use std::time::{Duration, Instant};

/// A moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// By the clock of limits and timeouts, which never jumps.
    pub at: Instant,
    /// By the node's clock, the clock of stamps \[ns\].
    pub stamp_ns: i64,
    /// Greatest delay of the node's clock: the step of a simulated one \[ns\].
    pub late_ns: i64,
    /// By the monotonic clock, which never stops.
    pub real: Instant,
}

impl Moment {
    /// A moment at which limits and timeouts use the monotonic clock.
    pub fn real(at: Instant, stamp_ns: i64) -> Self {
        Self {
            at,
            stamp_ns,
            late_ns: 0,
            real: at,
        }
    }

    /// Age of a measurement of this stamp at its reception, by the node's clock. One without a stamp is of the present.
    pub(super) fn age_of(&self, stamp_ns: i64) -> Duration {
        let age_ns = match stamp_ns {
            0 => 0,
            stamp_ns => self.stamp_ns.saturating_sub(stamp_ns),
        };
        // A stamp in the future has no age.
        Duration::from_nanos(u64::try_from(age_ns).unwrap_or(0))
    }

    /// Time from `self` to `now`, by `at` or by the node's clock: the longer one.
    pub(super) fn age(&self, now: Self) -> Duration {
        let by_stamp_ns = now.stamp_ns.saturating_sub(self.stamp_ns);
        // Zero if the clock was set back.
        let by_stamp = Duration::from_nanos(u64::try_from(by_stamp_ns).unwrap_or(0));
        by_stamp.max(now.at.saturating_duration_since(self.at))
    }
}
