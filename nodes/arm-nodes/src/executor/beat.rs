//! What the command periods, the limits and the timeouts go by: real time, or the node's clock.

use std::time::{Duration, Instant};

use tokio::{
    sync::watch,
    time::{Interval, MissedTickBehavior},
};
use wm_msgs::builtin_interfaces::Time;
use wm_ros::{Clock, Received};

use super::Now;

/// The beat of the commands.
pub(super) struct Beat {
    clock: Clock,
    source: Source,
}

enum Source {
    /// Real time, whatever the clock says: where an arm is real.
    Real(Interval),
    /// The clock: where an arm makes its own time.
    Clock {
        jumps: watch::Receiver<u64>,
        period_ns: i64,
        next_ns: i64,
        passed: Passed,
    },
}

impl Beat {
    /// One beat every `period`, of the node's clock or of real time.
    pub(super) fn new(is_clock: bool, period: Duration, clock: Clock) -> Self {
        let source = match is_clock {
            true => Source::Clock {
                jumps: clock.jumps(),
                period_ns: i64::try_from(period.as_nanos()).unwrap_or(i64::MAX),
                // A simulated clock stands at zero before it is heard of.
                next_ns: 1,
                passed: Passed::new(),
            },
            false => {
                let mut interval = tokio::time::interval(period);
                interval.set_missed_tick_behavior(MissedTickBehavior::Skip);
                Source::Real(interval)
            }
        };
        Self { clock, source }
    }

    /// Whether it stops where the node's clock stops.
    pub(super) fn is_clock(&self) -> bool {
        matches!(self.source, Source::Clock { .. })
    }

    /// The moment.
    pub(super) fn now(&mut self) -> Now {
        let stamp_ns = self.clock.now().to_nanos();
        let at = match &mut self.source {
            Source::Real(_) => Instant::now(),
            Source::Clock { passed, .. } => passed.go_to(stamp_ns),
        };
        Now { at, stamp_ns }
    }

    /// When a message came.
    pub(super) fn of<M>(&self, received: &Received<M>) -> Instant {
        match &self.source {
            Source::Real(_) => received.at,
            Source::Clock { passed, .. } => passed.before(received.received.to_nanos()),
        }
    }

    /// Waits for the next beat, or for the clock to jump back. What was missed is not made up for.
    pub(super) async fn tick(&mut self) {
        match &mut self.source {
            Source::Real(interval) => {
                interval.tick().await;
            }
            Source::Clock {
                jumps,
                period_ns,
                next_ns,
                ..
            } => {
                tokio::select! {
                    () = self.clock.sleep_until(Time::from_nanos(*next_ns)) => {}
                    _ = jumps.changed() => {}
                }
                let now_ns = self.clock.now().to_nanos();
                let is_on_time = (0..*period_ns).contains(&now_ns.saturating_sub(*next_ns));
                let last_ns = if is_on_time { *next_ns } else { now_ns };
                *next_ns = last_ns.saturating_add(*period_ns);
            }
        }
    }
}

/// Time by a clock that may jump, as instants that do not.
struct Passed {
    at: Instant,
    /// What the clock said then \[ns\].
    stamp_ns: i64,
}

impl Passed {
    fn new() -> Self {
        Self {
            at: Instant::now(),
            stamp_ns: 0,
        }
    }

    /// The clock says `stamp_ns`. No time passes when it goes back, nor when it is first heard of.
    fn go_to(&mut self, stamp_ns: i64) -> Instant {
        let passed_ns = stamp_ns.saturating_sub(self.stamp_ns).max(0);
        if self.stamp_ns > 0 {
            self.at += Duration::from_nanos(passed_ns.unsigned_abs());
        }
        self.stamp_ns = stamp_ns;
        self.at
    }

    /// When the clock said `stamp_ns`, not after the last moment.
    fn before(&self, stamp_ns: i64) -> Instant {
        let ago_ns = self.stamp_ns.saturating_sub(stamp_ns).max(0);
        let ago = Duration::from_nanos(ago_ns.unsigned_abs());
        self.at.checked_sub(ago).unwrap_or(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: i64 = 1_000_000_000;

    #[test]
    fn a_clock_that_jumps_gives_instants_that_do_not() {
        let mut passed = Passed::new();
        let begin = passed.at;
        assert_eq!(passed.go_to(1_700 * SECOND_NS), begin);
        let later = passed.go_to(1_702 * SECOND_NS);
        assert_eq!(later, begin + Duration::from_secs(2));
        assert_eq!(
            passed.before(1_701 * SECOND_NS),
            begin + Duration::from_secs(1)
        );
        // A message that was received by a time that the step has not been told of.
        assert_eq!(passed.before(1_703 * SECOND_NS), later);
        assert_eq!(passed.go_to(5 * SECOND_NS), later);
        assert_eq!(passed.go_to(6 * SECOND_NS), later + Duration::from_secs(1));
    }
}
