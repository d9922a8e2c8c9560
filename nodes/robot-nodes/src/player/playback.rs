//! Where a player is in its bag, and what it does next: a state machine without DDS, disk and clock.
//!
//! Its caller says what time it is, which message comes next, and what the user asks for; it answers whether to
//! publish, to wait, or to read from elsewhere. Moments are times since any fixed one; the bag's times are log times
//! \[ns\].

use std::ops::RangeInclusive;
use std::time::Duration;

/// Seconds of the bag in a second that can be asked for.
pub const RATES: RangeInclusive<f64> = 0.001..=1000.0;

/// What is played, and with which pauses in between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Log time at which it begins.
    pub start_ns: u64,
    /// Log time of the last message that may be played.
    pub last_ns: u64,
    /// Whether it begins again at its end.
    pub is_looping: bool,
    /// Time before each beginning, the first and those of a loop.
    pub delay: Duration,
    /// The least time between what was played and what follows a jump in the bag.
    pub gap: Duration,
    /// Longer gaps between messages of the bag are jumped over; `None`: none is.
    pub max_gap: Option<Duration>,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Nothing until this moment; `None`: until it is asked for something.
    Wait(Option<Duration>),
    /// Playing begins at this log time, before any message that follows.
    Begin(u64),
    /// Publish the next message.
    Publish,
    /// A gap between two log times was jumped over.
    Jump {
        /// The message before, or where it began.
        from_ns: u64,
        /// The message after.
        to_ns: u64,
    },
    /// Read from this log time on. It begins again there after a while.
    Rewind(u64),
    /// The playback is over, unless it is asked to begin again.
    Ended,
}

/// A moment, and the bag's time then.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Anchor {
    at: Duration,
    bag_ns: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// It begins at the anchor.
    Waiting,
    Playing,
    Ended,
}

/// A playback. Between two anchors the bag's time is a linear function of the time.
#[derive(Clone, Debug, PartialEq)]
pub struct Playback {
    plan: Plan,
    rate: f64,
    is_paused: bool,
    phase: Phase,
    anchor: Anchor,
    /// Messages that are still to be published although it is paused.
    burst: u64,
    /// The latest time told on `/clock` since the last jump.
    told_ns: u64,
    /// Log time of the latest message since the last jump, or where it went.
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
            told_ns: 0,
            reached_ns: plan.start_ns,
        }
    }

    /// What to do now, where the next message has the log time `next_ns`; `None`: there is no next one.
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
                // one that was due before the pause is published late: the time does not go back to it
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
                // a round takes as long as the bag, so that one of few messages does not spin
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

    /// Whether the next message is further away than the longest gap that is waited for.
    fn is_after_gap(&self, next_ns: u64) -> bool {
        let gap = Duration::from_nanos(next_ns.saturating_sub(self.reached_ns));
        self.plan.max_gap.is_some_and(|most| gap > most)
    }

    /// The bag's end, or, if the last message is further away, the longest gap after it.
    fn round_end_ns(&self) -> u64 {
        let most = self.plan.max_gap.map(|most| {
            let most_ns = u64::try_from(most.as_nanos()).unwrap_or(u64::MAX);
            self.reached_ns.saturating_add(most_ns)
        });
        self.plan.last_ns.min(most.unwrap_or(u64::MAX))
    }

    /// The bag's time now.
    #[must_use]
    pub fn position_ns(&self, now: Duration) -> u64 {
        if self.phase != Phase::Playing || self.is_paused {
            return self.anchor.bag_ns;
        }
        // exact to a microsecond over a hundred days: f64 has 53 bits
        let elapsed = now.saturating_sub(self.anchor.at).as_secs_f64();
        let position = self
            .anchor
            .bag_ns
            .saturating_add((elapsed * self.rate * 1e9) as u64);
        position.min(self.plan.last_ns.max(self.anchor.bag_ns))
    }

    /// When `bag_ns` is due if nothing changes; what lies before the anchor is due with it.
    fn due(&self, bag_ns: u64) -> Duration {
        let ahead_ns = bag_ns.saturating_sub(self.anchor.bag_ns);
        self.anchor.at + Duration::from_secs_f64(ahead_ns as f64 / 1e9 / self.rate)
    }

    /// Time from the moment zero to that of a stamp of the bag \[ns\], at the rate and since the jump that hold now.
    #[must_use]
    pub fn moment_ns(&self, stamp_ns: i64) -> i64 {
        let ahead_ns = i128::from(stamp_ns) - i128::from(self.anchor.bag_ns);
        // stamps lie near the bag's time: the difference in f64 is exact to well under a microsecond
        let scaled_ns = if self.rate == 1.0 {
            ahead_ns as i64
        } else {
            (ahead_ns as f64 / self.rate) as i64
        };
        let at_ns = i64::try_from(self.anchor.at.as_nanos()).unwrap_or(i64::MAX);
        at_ns.saturating_add(scaled_ns)
    }

    /// What `/clock` says when the bag's time is `bag_ns`: never less than it said since the last jump. `None` before
    /// playing begins and after its end.
    pub fn clock_ns(&mut self, bag_ns: u64) -> Option<u64> {
        if self.phase != Phase::Playing {
            return None;
        }
        self.told_ns = self.told_ns.max(bag_ns);
        Some(self.told_ns)
    }

    /// Whether a message may be wanted; else the next step does not depend on there being one.
    #[must_use]
    pub fn is_playing(&self) -> bool {
        self.phase == Phase::Playing
    }

    /// Whether it is over.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// Whether it is paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Seconds of the bag in a second.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Whether messages that [`burst`](Self::burst) asked for are still to be published.
    #[must_use]
    pub fn is_bursting(&self) -> bool {
        self.burst > 0
    }

    /// Holds the bag's time.
    pub fn pause(&mut self, now: Duration) {
        if self.is_playing() && !self.is_paused {
            self.hold(now, self.position_ns(now));
        }
        self.is_paused = true;
    }

    /// Goes on from where it was paused; ends a burst.
    pub fn resume(&mut self, now: Duration) {
        if self.is_playing() && self.is_paused {
            self.hold(now, self.anchor.bag_ns);
        }
        self.is_paused = false;
        self.burst = 0;
    }

    /// Plays at another rate from here on; false, and nothing changes, where it is none of [`RATES`].
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

    /// The first message after a jump is there: if that took a while, the bag's time goes on from this moment.
    pub fn begin_late(&mut self, now: Duration) {
        if self.is_playing() && !self.is_paused {
            self.anchor.at = self.anchor.at.max(now);
        }
    }

    /// Publishes the next `messages` although it is paused; false where it is not, or is over.
    pub fn burst(&mut self, messages: u64) -> bool {
        let can = self.is_paused && !self.is_ended();
        if can {
            self.burst = messages;
        }
        can
    }

    /// Goes on at another time of the bag, of its beginning where it lies before that, and also after the end: what
    /// was paused stays so. Gives the log time to read from; `None`, and nothing changes, for a time behind the end.
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

    /// Ends it.
    pub fn stop(&mut self, now: Duration) {
        self.hold(now, self.position_ns(now));
        self.phase = Phase::Ended;
        self.burst = 0;
    }

    /// Begins again from `start_ns` to `last_ns` after the delay; false, and nothing changes, where it is not over.
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
        self.told_ns = 0;
        self.reached_ns = bag_ns;
    }
}

#[cfg(test)]
mod tests;
