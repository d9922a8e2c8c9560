//! The clock of command periods, limits and timeouts: real time, or the node's clock.

use std::time::{Duration, Instant};

use tokio::{
    sync::watch,
    time::{Interval, MissedTickBehavior},
};
use wm_msgs::builtin_interfaces::Time;
use wm_ros::{Clock, Received};

use super::Moment;

/// The beat of the commands.
pub(super) struct Beat {
    clock: Clock,
    source: Source,
}

enum Source {
    /// Real time, independent of the node's clock: for a real arm.
    Real(Interval),
    /// The node's clock: for a simulated arm that makes its own time.
    Clock {
        jumps: watch::Receiver<u64>,
        period_ns: i64,
        next_ns: i64,
        passed: Passed,
        /// Real time between two beats while the clock stands still.
        period: Duration,
        /// A clock that is silent for longer stands still.
        timeout: Duration,
    },
}

impl Beat {
    /// One beat every `period`, by the node's clock or by real time. If the clock is silent for `timeout`, real time takes
    /// its place.
    pub(super) fn new(is_clock: bool, period: Duration, timeout: Duration, clock: Clock) -> Self {
        let source = match is_clock {
            true => Source::Clock {
                jumps: clock.jumps(),
                // 64 bits of nanoseconds hold 292 years.
                period_ns: i64::try_from(period.as_nanos()).unwrap_or(i64::MAX),
                // A simulated clock stands at zero until its first message.
                next_ns: 1,
                passed: Passed::new(),
                period,
                timeout,
            },
            false => {
                let mut interval = tokio::time::interval(period);
                interval.set_missed_tick_behavior(MissedTickBehavior::Skip);
                Source::Real(interval)
            }
        };
        Self { clock, source }
    }

    /// Whether it depends on the node's clock.
    pub(super) fn is_clock(&self) -> bool {
        matches!(self.source, Source::Clock { .. })
    }

    /// The present.
    pub(super) fn now(&mut self) -> Moment {
        let stamp_ns = self.clock.now().to_nanos();
        let real = Instant::now();
        let at = match &mut self.source {
            Source::Real(_) => real,
            Source::Clock { passed, .. } => passed.go_to(stamp_ns, real),
        };
        let late_ns = self.clock.step_ns();
        Moment {
            at,
            stamp_ns,
            late_ns,
            real,
        }
    }

    /// When a message came.
    pub(super) fn of<M>(&self, received: &Received<M>) -> Moment {
        let stamp_ns = received.received.to_nanos();
        Moment {
            at: match &self.source {
                Source::Real(_) => received.at,
                Source::Clock { passed, .. } => passed.before(stamp_ns),
            },
            stamp_ns,
            late_ns: self.clock.step_ns(),
            real: received.at,
        }
    }

    /// Waits for the next beat, for the clock to jump back, or for a period of real time. Missed beats are skipped.
    /// False: no command is due, and only the watchdog of the clock needs the present.
    pub(super) async fn tick(&mut self) -> bool {
        match &mut self.source {
            Source::Real(interval) => {
                interval.tick().await;
                true
            }
            Source::Clock {
                jumps,
                period_ns,
                next_ns,
                passed,
                period,
                timeout,
            } => {
                let due = passed.due_at(*timeout, *period);
                tokio::select! {
                    () = self.clock.sleep_until(Time::from_nanos(*next_ns)) => {}
                    _ = jumps.changed() => {}
                    () = tokio::time::sleep_until(due.into()) => {
                        let now_ns = self.clock.now().to_nanos();
                        return passed.go_on(now_ns, *timeout, *period, Instant::now());
                    }
                }
                passed.looked = Instant::now();
                let now_ns = self.clock.now().to_nanos();
                let is_on_time = (0..*period_ns).contains(&now_ns.saturating_sub(*next_ns));
                let last_ns = if is_on_time { *next_ns } else { now_ns };
                *next_ns = last_ns.saturating_add(*period_ns);
                true
            }
        }
    }
}

/// Time by a clock that may jump or stand still, as instants that do neither.
struct Passed {
    at: Instant,
    /// The time of the clock then \[ns\].
    stamp_ns: i64,
    /// When the clock advanced, or time went on in its place.
    since: Instant,
    /// Whether the clock stands still.
    is_silent: bool,
    /// When the clock was last looked at for the watchdog.
    looked: Instant,
}

impl Passed {
    fn new() -> Self {
        let now = Instant::now();
        Self {
            at: now,
            stamp_ns: 0,
            since: now,
            is_silent: false,
            looked: now,
        }
    }

    /// The clock reads `stamp_ns`. No time passes when it goes back, nor with its first message.
    fn go_to(&mut self, stamp_ns: i64, real: Instant) -> Instant {
        let passed_ns = stamp_ns.saturating_sub(self.stamp_ns).max(0);
        if self.stamp_ns > 0 {
            self.at += Duration::from_nanos(passed_ns.unsigned_abs());
        }
        if passed_ns > 0 {
            (self.since, self.is_silent) = (real, false);
        }
        self.stamp_ns = stamp_ns;
        self.at
    }

    /// When time goes on by itself, if the clock does not advance.
    fn silent_at(&self, timeout: Duration, period: Duration) -> Instant {
        self.since + if self.is_silent { period } else { timeout }
    }

    /// When to look at the clock again. Without a look in each period, one that stops between two beats would seem to
    /// advance `timeout` later.
    fn due_at(&self, timeout: Duration, period: Duration) -> Instant {
        (self.looked + period).min(self.silent_at(timeout, period))
    }

    /// Looks at the clock. If it stands still and it is time, time goes on by itself; whether it did.
    fn go_on(&mut self, stamp_ns: i64, timeout: Duration, period: Duration, real: Instant) -> bool {
        self.looked = real;
        if stamp_ns > self.stamp_ns || real < self.silent_at(timeout, period) {
            return false;
        }
        let (is_first, since) = (!self.is_silent, self.since);
        self.go_to(stamp_ns, real);
        let passed = real.saturating_duration_since(since);
        self.at += match is_first {
            // No command was sent meanwhile.
            true => passed.saturating_sub(timeout),
            false => passed,
        };
        (self.since, self.is_silent) = (real, true);
        true
    }

    /// When the clock read `stamp_ns`, not after the last moment.
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
        let (begin, real) = (passed.at, Instant::now());
        assert_eq!(passed.go_to(1_700 * SECOND_NS, real), begin);
        let later = passed.go_to(1_702 * SECOND_NS, real);
        assert_eq!(later, begin + Duration::from_secs(2));
        assert_eq!(
            passed.before(1_701 * SECOND_NS),
            begin + Duration::from_secs(1)
        );
        // A message that was received at a time that the step does not know yet.
        assert_eq!(passed.before(1_703 * SECOND_NS), later);
        assert_eq!(passed.go_to(5 * SECOND_NS, real), later);
        let last = passed.go_to(6 * SECOND_NS, real);
        assert_eq!(last, later + Duration::from_secs(1));
    }

    #[test]
    fn real_time_goes_on_while_the_clock_stands_still() {
        let (timeout, period) = (Duration::from_secs(1), Duration::from_millis(50));
        let mut passed = Passed::new();
        let real = Instant::now();
        passed.go_to(1_700 * SECOND_NS, real);
        let at = passed.at;
        let mut due = passed.silent_at(timeout, period);
        assert_eq!(due, real + timeout);
        for count in 0..4 {
            assert!(passed.go_on(1_700 * SECOND_NS, timeout, period, due));
            assert_eq!(passed.at, at + count * period);
            due = passed.silent_at(timeout, period);
        }
        // It advances again.
        let at = passed.go_to(1_701 * SECOND_NS, due);
        assert_eq!(passed.silent_at(timeout, period), due + timeout);
        assert!(!passed.go_on(1_702 * SECOND_NS, timeout, period, due + timeout));
        passed.go_to(1_702 * SECOND_NS, due + timeout);
        assert_eq!(passed.at, at + Duration::from_secs(1));
        assert!(!passed.is_silent);
    }

    #[test]
    fn a_clock_that_stops_between_two_beats_is_noticed_in_a_period() {
        let (timeout, period) = (Duration::from_secs(1), Duration::from_millis(50));
        let mut passed = Passed::new();
        let mut real = passed.looked;
        passed.go_to(1_700 * SECOND_NS, real);
        // It advances by less than a period, and stops.
        let stopped_ns = 1_700 * SECOND_NS + 30_000_000;
        let begin = real;
        loop {
            real = passed.due_at(timeout, period);
            if passed.go_on(stopped_ns, timeout, period, real) {
                break;
            }
            passed.go_to(stopped_ns, real);
        }
        assert_eq!(real, begin + period + timeout);
    }
}
