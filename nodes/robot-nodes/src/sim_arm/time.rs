//! What time it is for the simulated arm: that of the node's clock, or time that it makes itself.

use std::time::{Duration, Instant};

use wm_msgs::builtin_interfaces::Time;
use wm_ros::Clock;
use wm_sim::START_NS;

/// Time that the arm makes goes on by this much at most without being told \[ns\].
const TELL_NS: i64 = 20_000_000;

/// What time it is for the simulated arm.
pub(super) enum ArmTime {
    /// That of the node's clock.
    Clock(Clock),
    /// Its own.
    Made(MadeTime),
}

/// Time that the arm makes.
pub(super) struct MadeTime {
    pace: Pace,
    now_ns: i64,
    /// When that was.
    at: Instant,
}

enum Pace {
    /// So many seconds in one of real time.
    Factor(f64),
    /// A step goes on once it is answered, or when that has been out for too long.
    Answered {
        is_answered: bool,
        timeout: Duration,
    },
}

impl ArmTime {
    /// That of `clock` where `real_time_factor` is 1.
    pub(super) fn new(real_time_factor: f64, timeout: Duration, clock: Clock) -> Self {
        // Exactly what the parameter says.
        if real_time_factor == 1.0 {
            return Self::Clock(clock);
        }
        let pace = match real_time_factor > 0.0 {
            true => Pace::Factor(real_time_factor),
            // The first step only looks.
            false => Pace::Answered {
                is_answered: true,
                timeout,
            },
        };
        Self::Made(MadeTime {
            pace,
            // 2023: as the recordings of the simulator.
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

    /// A command has come at `received`: when that was \[ns\].
    pub(super) fn at(&self, received: Time) -> i64 {
        match self {
            Self::Clock(_) => received.to_nanos(),
            Self::Made(made) => made.now_ns,
        }
    }

    /// A command that a step waits for has come.
    pub(super) fn answer(&mut self) {
        if let Self::Made(MadeTime {
            pace: Pace::Answered { is_answered, .. },
            ..
        }) = self
        {
            *is_answered = true;
        }
    }

    /// Waits until [`Self::go_on`] may go on towards `wake_ns`, be that a step or not.
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

    /// Goes on towards `wake_ns`: the time now, and whether it has to be told on `/clock`.
    pub(super) fn go_on(&mut self, wake_ns: i64, is_step: bool) -> (i64, bool) {
        match self {
            Self::Clock(clock) => (clock.now().to_nanos(), false),
            Self::Made(made) => (made.go_on(wake_ns, is_step, Instant::now()), true),
        }
    }
}

impl MadeTime {
    /// What comes next on the way to a time \[ns\].
    fn next_ns(&self, wake_ns: i64) -> i64 {
        match self.pace {
            Pace::Factor(_) => wake_ns.min(self.now_ns.saturating_add(TELL_NS)),
            Pace::Answered { .. } => wake_ns,
        }
    }

    /// When that comes; none: at once.
    fn due(&self, wake_ns: i64, is_step: bool) -> Option<Instant> {
        match self.pace {
            Pace::Factor(factor) => {
                let ahead_ns = self.next_ns(wake_ns).saturating_sub(self.now_ns).max(0);
                let real = Duration::from_nanos(ahead_ns.unsigned_abs()).div_f64(factor);
                Some(self.at + real)
            }
            Pace::Answered {
                is_answered,
                timeout,
            } => (is_step && !is_answered).then(|| self.at + timeout),
        }
    }

    fn go_on(&mut self, wake_ns: i64, is_step: bool, now: Instant) -> i64 {
        let next_ns = self.next_ns(wake_ns);
        let due = self.due(wake_ns, is_step);
        let told = Duration::from_nanos(TELL_NS.unsigned_abs());
        self.at = match self.pace {
            // What is a little late is made up for; a pause is not, and a slow machine makes time slow.
            Pace::Factor(_) => due
                .filter(|due| now.saturating_duration_since(*due) <= told)
                .unwrap_or(now),
            Pace::Answered { .. } => now,
        };
        if let Pace::Answered { is_answered, .. } = &mut self.pace
            && is_step
        {
            *is_answered = false;
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
    fn a_factor_makes_time_faster_and_tells_it_often() {
        let mut time = made(Pace::Factor(4.0));
        let begin = time.at;
        for count in 1..=10 {
            let due = time.due(STEP_NS, true).unwrap();
            assert_eq!(due, begin + count * Duration::from_millis(5));
            // A little late, each time.
            let late = Duration::from_millis(1);
            assert_eq!(
                time.go_on(STEP_NS, true, due + late),
                i64::from(count) * TELL_NS
            );
        }
        // A pause is not made up for.
        let later = begin + Duration::from_secs(9);
        time.go_on(2 * STEP_NS, true, later);
        assert_eq!(
            time.due(2 * STEP_NS, true),
            Some(later + Duration::from_millis(5))
        );
    }

    #[test]
    fn a_step_waits_for_its_answer_but_not_for_ever() {
        let timeout = Duration::from_secs(1);
        let mut time = ArmTime::Made(made(Pace::Answered {
            is_answered: true,
            timeout,
        }));
        let due = |time: &ArmTime, is_step| match time {
            ArmTime::Made(made) => made.due(made.now_ns + STEP_NS, is_step),
            ArmTime::Clock(_) => None,
        };
        assert_eq!(due(&time, true), None);
        let (now_ns, is_told) = time.go_on(STEP_NS, true);
        assert!(is_told && now_ns == STEP_NS);
        let before = Instant::now();
        let waits = due(&time, true).unwrap();
        assert!(waits <= before + timeout);
        // A late picture does not wait, and does not make up for an answer.
        assert_eq!(due(&time, false), None);
        assert_eq!(time.go_on(STEP_NS + 5, false).0, STEP_NS + 5);
        assert!(due(&time, true).is_some());
        time.answer();
        assert_eq!(due(&time, true), None);
        assert_eq!(time.at(Time::from_nanos(7)), STEP_NS + 5);
    }
}
