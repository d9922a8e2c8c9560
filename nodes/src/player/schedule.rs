//! When a message of the bag is due, and what time the bag's time is now.

use std::time::Duration;

/// One pass through a bag: the bag's time as a linear function of the time since the pass began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// The bag's time at the beginning of the pass \[ns\].
    bag_start_ns: u64,
    /// Seconds of the bag in a second.
    rate: f64,
}

impl Schedule {
    /// A pass from `bag_start_ns` at `rate`, which is finite and above 0.
    #[must_use]
    pub fn new(bag_start_ns: u64, rate: f64) -> Self {
        Self { bag_start_ns, rate }
    }

    /// Time from the beginning of the pass until `bag_ns` is due; zero for what lies before it.
    #[must_use]
    pub fn due(&self, bag_ns: u64) -> Duration {
        // exact to a microsecond over a hundred days: f64 has 53 bits
        Duration::from_secs_f64((bag_ns.saturating_sub(self.bag_start_ns)) as f64 / 1e9 / self.rate)
    }

    /// The bag's time \[ns\] at `elapsed` since the beginning of the pass.
    #[must_use]
    pub fn bag_time_ns(&self, elapsed: Duration) -> u64 {
        self.bag_start_ns
            .saturating_add((elapsed.as_secs_f64() * self.rate * 1e9) as u64)
    }

    /// The stamp \[ns\] that replaces `stamp_ns` in a pass that began at `wall_start_ns`.
    #[must_use]
    pub fn restamped_ns(&self, stamp_ns: i64, wall_start_ns: i64) -> i64 {
        // stamps lie near the bag's start: the difference in f64 is exact to well under a microsecond
        let since_start_ns = i128::from(stamp_ns) - i128::from(self.bag_start_ns);
        let scaled = if self.rate == 1.0 {
            since_start_ns as i64
        } else {
            (since_start_ns as f64 / self.rate) as i64
        };
        wall_start_ns.saturating_add(scaled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_due_at_their_distance_over_the_rate() {
        let schedule = Schedule::new(1_700_000_000_000_000_000, 2.0);
        assert_eq!(
            schedule.due(1_700_000_000_400_000_000),
            Duration::from_millis(200)
        );
        assert_eq!(schedule.due(1_600_000_000_000_000_000), Duration::ZERO);
        assert_eq!(
            schedule.bag_time_ns(Duration::from_millis(200)),
            1_700_000_000_400_000_000
        );
    }

    #[test]
    fn stamps_keep_their_distances() {
        let start = 1_700_000_000_123_456_789;
        let real = Schedule::new(start, 1.0);
        assert_eq!(
            real.restamped_ns(start as i64 + 200_000_001, 50),
            200_000_051
        );
        assert_eq!(real.restamped_ns(start as i64 - 10, 50), 40);
        let double = Schedule::new(start, 2.0);
        assert_eq!(double.restamped_ns(start as i64 + 200, 50), 150);
    }
}
