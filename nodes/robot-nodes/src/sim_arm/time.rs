//! The arm's time: the node's clock, or time that the node makes itself.

use std::time::{Duration, Instant};

use wm_msgs::builtin_interfaces::Time;
use wm_ros::Clock;
use wm_sim::START_NS;

/// Largest step of the time that the node makes \[ns\]: `/clock` gets a message for each.
const CLOCK_STEP_NS: i64 = 20_000_000;

/// The arm's time.
pub(super) enum ArmTime {
    /// The node's clock.
    Clock(Clock),
    /// Time that the node makes.
    Made(MadeTime),
}

/// Time that the node makes.
pub(super) struct MadeTime {
    pace: Pace,
    now_ns: i64,
    /// Real time of `now_ns`.
    at: Instant,
}

enum Pace {
    /// Seconds per second of real time.
    Factor(f64),
    /// A step waits for a command, at most for the timeout.
    PerCommand {
        has_command: bool,
        timeout: Duration,
    },
}

impl ArmTime {
    /// The time of `clock` if `real_time_factor` is 1; otherwise the node makes it.
    pub(super) fn new(real_time_factor: f64, timeout: Duration, clock: Clock) -> Self {
        // The parameter is exactly 1 by default.
        if real_time_factor == 1.0 {
            return Self::Clock(clock);
        }
        let pace = match real_time_factor > 0.0 {
            true => Pace::Factor(real_time_factor),
            // The first step needs no command: it only takes a picture.
            false => Pace::PerCommand {
                has_command: true,
                timeout,
            },
        };
        Self::Made(MadeTime {
            pace,
            // 2023, as in the simulator's recordings.
            now_ns: START_NS as i64,
            at: Instant::now(),
        })
    }

    /// The time now \[ns\].
    pub(super) fn now_ns(&self) -> i64 {
        match self {
            Self::Clock(clock) => clock.now().to_nanos(),
            Self::Made(made) => made.now_ns,
        }
    }

    /// The arm's time of a command that was received at `received` \[ns\].
    pub(super) fn at(&self, received: Time) -> i64 {
        match self {
            Self::Clock(_) => received.to_nanos(),
            Self::Made(made) => made.now_ns,
        }
    }

    /// Notes a command: the step that waits for it can start.
    pub(super) fn note_command(&mut self) {
        if let Self::Made(MadeTime {
            pace: Pace::PerCommand { has_command, .. },
            ..
        }) = self
        {
            *has_command = true;
        }
    }

    /// Waits until [`Self::advance`] is due. `is_step`: a step is due at `wake_ns`.
    pub(super) async fn wait(&self, wake_ns: i64, is_step: bool) {
        match self {
            Self::Clock(clock) => clock.sleep_until(Time::from_nanos(wake_ns)).await,
            Self::Made(made) => {
                if let Some(due) = made.due(wake_ns, is_step) {
                    tokio::time::sleep_until(due.into()).await;
                }
            }
        }
    }

    /// Advances towards `wake_ns`. Returns the time, and whether to publish it on `/clock`.
    pub(super) fn advance(&mut self, wake_ns: i64, is_step: bool) -> (i64, bool) {
        match self {
            Self::Clock(clock) => (clock.now().to_nanos(), false),
            Self::Made(made) => (made.advance(wake_ns, is_step, Instant::now()), true),
        }
    }
}

impl MadeTime {
    /// The next time on the way to `wake_ns` \[ns\].
    fn next_ns(&self, wake_ns: i64) -> i64 {
        match self.pace {
            Pace::Factor(_) => wake_ns.min(self.now_ns.saturating_add(CLOCK_STEP_NS)),
            Pace::PerCommand { .. } => wake_ns,
        }
    }

    /// The moment of that time; `None`: at once.
    fn due(&self, wake_ns: i64, is_step: bool) -> Option<Instant> {
        match self.pace {
            Pace::Factor(factor) => {
                let ahead_ns = self.next_ns(wake_ns).saturating_sub(self.now_ns).max(0);
                let real = Duration::from_nanos(ahead_ns.unsigned_abs()).div_f64(factor);
                Some(self.at + real)
            }
            Pace::PerCommand {
                has_command,
                timeout,
            } => (is_step && !has_command).then(|| self.at + timeout),
        }
    }

    fn advance(&mut self, wake_ns: i64, is_step: bool, now: Instant) -> i64 {
        let next_ns = self.next_ns(wake_ns);
        let due = self.due(wake_ns, is_step);
        let clock_step = Duration::from_nanos(CLOCK_STEP_NS.unsigned_abs());
        self.at = match self.pace {
            // A small delay is made up for. A pause is not: on a slow machine, time is slow.
            Pace::Factor(_) => due
                .filter(|due| now.saturating_duration_since(*due) <= clock_step)
                .unwrap_or(now),
            Pace::PerCommand { .. } => now,
        };
        if let Pace::PerCommand { has_command, .. } = &mut self.pace
            && is_step
        {
            *has_command = false;
        }
        self.now_ns = self.now_ns.max(next_ns);
        self.now_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: i64 = 200_000_000;

    fn made(pace: Pace) -> MadeTime {
        MadeTime {
            pace,
            now_ns: 0,
            at: Instant::now(),
        }
    }

    #[test]
    fn factor_makes_time_faster_in_small_steps() {
        let mut time = made(Pace::Factor(4.0));
        let begin = time.at;
        for count in 1..=10 {
            let due = time.due(STEP_NS, true).unwrap();
            assert_eq!(due, begin + count * Duration::from_millis(5));
            // Each time a small delay.
            let late = Duration::from_millis(1);
            assert_eq!(
                time.advance(STEP_NS, true, due + late),
                i64::from(count) * CLOCK_STEP_NS
            );
        }
        // A pause is not made up for.
        let later = begin + Duration::from_secs(9);
        time.advance(2 * STEP_NS, true, later);
        assert_eq!(
            time.due(2 * STEP_NS, true),
            Some(later + Duration::from_millis(5))
        );
    }

    #[test]
    fn step_waits_for_its_command_until_the_timeout() {
        let timeout = Duration::from_secs(1);
        let mut time = ArmTime::Made(made(Pace::PerCommand {
            has_command: true,
            timeout,
        }));
        let due = |time: &ArmTime, is_step| match time {
            ArmTime::Made(made) => made.due(made.now_ns + STEP_NS, is_step),
            ArmTime::Clock(_) => None,
        };
        assert_eq!(due(&time, true), None);
        let (now_ns, is_made) = time.advance(STEP_NS, true);
        assert!(is_made && now_ns == STEP_NS);
        let before = Instant::now();
        let waits = due(&time, true).unwrap();
        assert!(waits <= before + timeout);
        // A late picture does not wait, and does not count as a command.
        assert_eq!(due(&time, false), None);
        assert_eq!(time.advance(STEP_NS + 5, false).0, STEP_NS + 5);
        assert!(due(&time, true).is_some());
        time.note_command();
        assert_eq!(due(&time, true), None);
        assert_eq!(time.at(Time::from_nanos(7)), STEP_NS + 5);
    }
}
