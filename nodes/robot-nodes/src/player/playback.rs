//! The position of a player in its bag, and its next step: a state machine without DDS, disk and clock.
//!
//! The caller supplies the time, the next message, and the requests of the user. The state machine returns whether to
//! publish, to wait, or to read from another time. Moments are durations since a fixed moment; times of the bag are log
//! times \[ns\].

use std::ops::RangeInclusive;
use std::time::Duration;

/// Valid rates: seconds of the bag per second.
pub const RATES: RangeInclusive<f64> = 0.001..=1000.0;

/// The part of the bag to play, and the pauses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Log time of the beginning.
    pub start_ns: u64,
    /// Log time after which no message is played.
    pub last_ns: u64,
    /// Whether the playback starts again at its end.
    pub is_looping: bool,
    /// Time before the first message of each round of the loop.
    pub delay: Duration,
    /// Least time between the last message before a jump in the bag and the first one after it.
    pub gap: Duration,
    /// Longer gaps between messages are skipped; `None`: no gap is.
    pub max_gap: Option<Duration>,
}

/// The next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Wait until this moment; `None`: until a request.
    Wait(Option<Duration>),
    /// Begin to play at this log time. The messages follow.
    Begin(u64),
    /// Publish the next message.
    Publish,
    /// A gap between two log times is skipped.
    Jump {
        /// Log time of the previous message, or of the beginning.
        from_ns: u64,
        /// Log time of the next message.
        to_ns: u64,
    },
    /// Read again from this log time on, for the next round of the loop.
    Rewind(u64),
    /// The playback has ended. A request can start it again.
    Ended,
}

/// A moment, and the bag's time at that moment.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Anchor {
    at: Duration,
    bag_ns: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Before the beginning, which is at the anchor.
    Waiting,
    Playing,
    Ended,
}

/// A playback. The bag's time is a linear function of the moment, through the anchor.
#[derive(Clone, Debug, PartialEq)]
pub struct Playback {
    plan: Plan,
    rate: f64,
    is_paused: bool,
    phase: Phase,
    anchor: Anchor,
    /// Messages to publish during the pause.
    burst: u64,
    /// The latest time on `/clock` since the last jump.
    published_ns: u64,
    /// Log time of the latest message since the last jump, or the target of that jump.
    reached_ns: u64,
}

impl Playback {
    /// A playback that begins `plan.delay` after `now`. `rate` is one of [`RATES`].
    #[must_use]
    pub fn new(plan: Plan, rate: f64, is_paused: bool, now: Duration) -> Self {
        let anchor = Anchor {
            at: now + plan.delay,
            bag_ns: plan.start_ns,
        };
        Self {
            plan,
            rate,
            is_paused,
            phase: Phase::Waiting,
            anchor,
            burst: 0,
            published_ns: 0,
            reached_ns: plan.start_ns,
        }
    }

    /// The step at `now`. `next_ns` is the log time of the next message; `None` at the end.
    pub fn step(&mut self, now: Duration, next_ns: Option<u64>) -> Step {
        match self.phase {
            Phase::Ended => return Step::Ended,
            Phase::Waiting if now < self.anchor.at => return Step::Wait(Some(self.anchor.at)),
            Phase::Waiting => {
                self.phase = Phase::Playing;
                return Step::Begin(self.anchor.bag_ns);
            }
            Phase::Playing => {}
        }
        match next_ns.filter(|next_ns| *next_ns <= self.plan.last_ns) {
            Some(next_ns) if self.is_paused && self.burst > 0 => {
                self.burst -= 1;
                // A message that was due before the pause is published late. The time does not go back.
                self.hold(now, next_ns.max(self.anchor.bag_ns));
                self.publish(next_ns)
            }
            Some(_) if self.is_paused => Step::Wait(None),
            Some(next_ns) if self.is_after_gap(next_ns) => {
                let from_ns = self.reached_ns;
                self.hold(now + self.plan.gap, next_ns);
                self.reached_ns = next_ns;
                Step::Jump {
                    from_ns,
                    to_ns: next_ns,
                }
            }
            Some(next_ns) => match self.due(next_ns) {
                due if due <= now => self.publish(next_ns),
                due => Step::Wait(Some(due)),
            },
            None if self.is_paused => {
                self.burst = 0;
                Step::Wait(None)
            }
            None if self.plan.is_looping && self.plan.last_ns > self.plan.start_ns => {
                // A round takes as long as the bag. A round of few messages would otherwise repeat without a pause.
                let end = self.due(self.round_end_ns());
                if now < end {
                    return Step::Wait(Some(end));
                }
                self.jump(now + self.plan.delay.max(self.plan.gap), self.plan.start_ns);
                Step::Rewind(self.plan.start_ns)
            }
            None => {
                self.hold(now, self.position_ns(now));
                self.phase = Phase::Ended;
                Step::Ended
            }
        }
    }

    fn publish(&mut self, next_ns: u64) -> Step {
        self.reached_ns = self.reached_ns.max(next_ns);
        Step::Publish
    }

    /// Whether the gap before the next message is skipped.
    fn is_after_gap(&self, next_ns: u64) -> bool {
        let gap = Duration::from_nanos(next_ns.saturating_sub(self.reached_ns));
        self.plan.max_gap.is_some_and(|most| gap > most)
    }

    /// Log time of the end: that of the bag, or at most the longest gap after the last message.
    fn round_end_ns(&self) -> u64 {
        let most = self.plan.max_gap.map(|most| {
            // At most a day, by the parameter.
            let most_ns = u64::try_from(most.as_nanos()).unwrap_or(u64::MAX);
            self.reached_ns.saturating_add(most_ns)
        });
        // Without a longest gap, only the end of the bag counts.
        self.plan.last_ns.min(most.unwrap_or(u64::MAX))
    }

    /// The bag's time at `now`.
    #[must_use]
    pub fn position_ns(&self, now: Duration) -> u64 {
        if self.phase != Phase::Playing || self.is_paused {
            return self.anchor.bag_ns;
        }
        // Exact to a microsecond over a hundred days: f64 has 53 bits.
        let elapsed = now.saturating_sub(self.anchor.at).as_secs_f64();
        let position = self
            .anchor
            .bag_ns
            .saturating_add((elapsed * self.rate * 1e9) as u64);
        position.min(self.plan.last_ns.max(self.anchor.bag_ns))
    }

    /// The moment at which `bag_ns` is due at this rate. Earlier times than the anchor's are due with it.
    fn due(&self, bag_ns: u64) -> Duration {
        let ahead_ns = bag_ns.saturating_sub(self.anchor.bag_ns);
        self.anchor.at + Duration::from_secs_f64(ahead_ns as f64 / 1e9 / self.rate)
    }

    /// Time from moment zero to that of a stamp of the bag \[ns\], by the present rate and anchor.
    #[must_use]
    pub fn moment_ns(&self, stamp_ns: i64) -> i64 {
        let ahead_ns = i128::from(stamp_ns) - i128::from(self.anchor.bag_ns);
        // Stamps are near the bag's time: the difference in f64 is exact to less than a microsecond.
        let scaled_ns = if self.rate == 1.0 {
            ahead_ns as i64
        } else {
            (ahead_ns as f64 / self.rate) as i64
        };
        // 64 bits of nanoseconds hold 292 years.
        let at_ns = i64::try_from(self.anchor.at.as_nanos()).unwrap_or(i64::MAX);
        at_ns.saturating_add(scaled_ns)
    }

    /// The time to publish on `/clock` when the bag's time is `bag_ns`. It never decreases between two jumps. `None`
    /// before the beginning and after the end.
    pub fn clock_ns(&mut self, bag_ns: u64) -> Option<u64> {
        if self.phase != Phase::Playing {
            return None;
        }
        self.published_ns = self.published_ns.max(bag_ns);
        Some(self.published_ns)
    }

    /// Whether the next step depends on the next message.
    #[must_use]
    pub fn is_playing(&self) -> bool {
        self.phase == Phase::Playing
    }

    /// Whether the playback has ended.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// Whether the playback is paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Seconds of the bag per second.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Whether messages of a [`burst`](Self::burst) are still to be published.
    #[must_use]
    pub fn is_bursting(&self) -> bool {
        self.burst > 0
    }

    /// Pauses: the bag's time stands still.
    pub fn pause(&mut self, now: Duration) {
        if self.is_playing() && !self.is_paused {
            self.hold(now, self.position_ns(now));
        }
        self.is_paused = true;
    }

    /// Continues from the time of the pause, and ends a burst.
    pub fn resume(&mut self, now: Duration) {
        if self.is_playing() && self.is_paused {
            self.hold(now, self.anchor.bag_ns);
        }
        self.is_paused = false;
        self.burst = 0;
    }

    /// Changes the rate from `now` on. Returns false, without an effect, if it is not one of [`RATES`].
    pub fn set_rate(&mut self, now: Duration, rate: f64) -> bool {
        if !RATES.contains(&rate) {
            return false;
        }
        if self.is_playing() && !self.is_paused {
            self.hold(now, self.position_ns(now));
        }
        self.rate = rate;
        true
    }

    /// Handles the first message after a jump: the bag's time continues at `now`, however long reading took.
    pub fn begin_late(&mut self, now: Duration) {
        if self.is_playing() && !self.is_paused {
            self.anchor.at = self.anchor.at.max(now);
        }
    }

    /// Publishes the next `messages` during the pause. Returns false if the playback is not paused, or has ended.
    pub fn burst(&mut self, messages: u64) -> bool {
        let can = self.is_paused && !self.is_ended();
        if can {
            self.burst = messages;
        }
        can
    }

    /// Jumps to another time of the bag, at the earliest to its beginning, also after the end. A pause continues.
    /// Returns the log time to read from; `None`, without an effect, if the time is after the end.
    pub fn seek(&mut self, now: Duration, bag_ns: u64) -> Option<u64> {
        if bag_ns > self.plan.last_ns {
            return None;
        }
        let bag_ns = bag_ns.max(self.plan.start_ns);
        let begins = now + self.plan.gap;
        let begins = match self.phase {
            Phase::Waiting => begins.max(self.anchor.at),
            Phase::Playing | Phase::Ended => begins,
        };
        self.jump(begins, bag_ns);
        Some(bag_ns)
    }

    /// Ends the playback.
    pub fn stop(&mut self, now: Duration) {
        self.hold(now, self.position_ns(now));
        self.phase = Phase::Ended;
        self.burst = 0;
    }

    /// Plays from `start_ns` to `last_ns` after the delay. Returns false, without an effect, if the playback has not ended.
    pub fn play(&mut self, now: Duration, start_ns: u64, last_ns: u64) -> bool {
        if !self.is_ended() {
            return false;
        }
        self.plan = Plan {
            start_ns,
            last_ns,
            ..self.plan
        };
        self.jump(now + self.plan.delay.max(self.plan.gap), start_ns);
        true
    }

    fn hold(&mut self, at: Duration, bag_ns: u64) {
        self.anchor = Anchor { at, bag_ns };
    }

    fn jump(&mut self, at: Duration, bag_ns: u64) {
        self.hold(at, bag_ns);
        self.phase = Phase::Waiting;
        self.burst = 0;
        self.published_ns = 0;
        self.reached_ns = bag_ns;
    }
}

#[cfg(test)]
mod tests;
