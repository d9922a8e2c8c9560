//! How often a node works if the work takes longer than the time between inputs.
//!
//! A node that takes the newest frame whenever it is free uses frames at odd distances, and half of its results are late
//! before it begins. A [`Cadence`] picks every nth input instead: n is the least number for which the work ends before the
//! next picked input arrives. Inputs in between are skipped and counted ([`SKIPPED`]).
//!
//! n follows from measured times, of the work and of the inputs (a bag may be played at another rate). It rises when the
//! median of the last five times no longer fits, and falls when the longest of them would fit with a tenth to spare, so
//! that a single hiccup changes nothing and n does not swing between two values.
//!
//! It has no clock: every call brings the time. Which camera frames a slow encoder takes is another question, since a
//! context needs frames a model step apart: [`Choice`](crate::encoder::Choice).

mod measured;
mod recent;
mod words;

use std::time::{Duration, Instant};

pub use measured::measured;
pub(crate) use recent::{Arrivals, Recent};
pub use words::{every_nth, hertz, rough};

/// The name under which `/diagnostics` counts skipped inputs.
pub const SKIPPED: &str = "pace";

/// The key under which `/diagnostics` reports how often the node works.
pub const PACE: &str = "pace";

/// Reported while the first runs are measured.
pub(crate) const OPEN: &str = "the first runs will tell which frames are used";

/// The longest of the last runs times this must fit before the node works more often.
const MARGIN: f64 = 1.1;

/// A machine that starts loads other models too, and is slower than later: a time measured then counts only if it takes
/// this many periods.
const BELIEVED_PERIODS: u32 = 2;

/// The state of a node when an input arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// Nothing.
    Idle,
    /// Works.
    Busy,
    /// Works, and an earlier input waits for its turn.
    Waiting,
}

/// What happens to an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The work begins, or the input waits for its turn.
    Use,
    /// It replaces an older one that waits, which is skipped.
    Replace,
    /// The same, but the older one was due: the machine has become slower.
    ReplaceLate,
    /// It is skipped.
    Skip,
}

/// Picks every nth input.
#[derive(Clone, Debug)]
pub struct Cadence {
    nth: u32,
    told: u32,
    /// From one input to the next, until that has been measured.
    period: Duration,
    /// How long the work takes, until that has been measured.
    estimate: Option<Duration>,
    inputs: Arrivals,
    taken: Recent,
    /// When the last work began, and the number of inputs since.
    last: Option<(Instant, u32)>,
}

impl Cadence {
    /// For inputs `period` apart and work that took `estimate` in a trial.
    pub fn new(period: Duration, estimate: Option<Duration>) -> Self {
        let nth = believed(estimate, period);
        Self {
            nth,
            told: nth,
            period,
            estimate,
            inputs: Arrivals::default(),
            taken: Recent::default(),
            last: None,
        }
    }

    /// Whether the time of the work is still to be measured by the first runs.
    pub fn is_open(&self) -> bool {
        let tried = self.estimate.map(|taken| periods(taken, self.period));
        self.taken.median().is_none() && tried != Some(self.nth)
    }

    /// The n of "every nth input".
    pub fn nth(&self) -> u32 {
        self.nth
    }

    /// Records an input with the stamp `stamp_ns` that arrives at `now`, and returns what happens to it.
    pub fn arrived(&mut self, stamp_ns: i64, now: Instant, load: Load) -> Verdict {
        self.inputs.push(now, stamp_ns);
        if let Some((_, since)) = &mut self.last {
            *since = since.saturating_add(1);
        }
        self.adapt();
        let gap = self.gap();
        // Inputs that are late or slower than estimated make up for those that did not arrive.
        let enough = (gap * self.nth).saturating_sub(gap / 2);
        let is_due = self.last.is_none_or(|(begun, since)| {
            since >= self.nth || now.saturating_duration_since(begun) >= enough
        });
        match load {
            Load::Idle if is_due => {
                self.begun(now);
                Verdict::Use
            }
            Load::Busy if is_due => Verdict::Use,
            Load::Idle | Load::Busy => Verdict::Skip,
            Load::Waiting => match self.last {
                Some((_, since)) if since.is_multiple_of(self.nth.max(1)) => Verdict::ReplaceLate,
                _ => Verdict::Replace,
            },
        }
    }

    /// The work has begun from the newest input.
    pub fn begun(&mut self, now: Instant) {
        self.last = Some((now, 0));
    }

    /// The work took this long.
    pub fn took(&mut self, taken: Duration) {
        self.taken.push(taken);
        self.adapt();
    }

    /// From now on the work takes `factor` times as long as before.
    pub fn scale(&mut self, factor: f64) {
        self.taken.scale(factor);
        self.estimate = self.estimate.map(|estimate| estimate.mul_f64(factor));
        self.adapt();
    }

    /// The time of the work and between inputs, if n has changed since the last call.
    pub fn change(&mut self) -> Option<(Duration, Duration)> {
        if self.nth == self.told {
            return None;
        }
        self.told = self.nth;
        let taken = self.taken.median();
        Some((taken.or(self.taken.at_most(self.estimate))?, self.gap()))
    }

    /// The time between used inputs, within which the work should end.
    pub fn interval(&self) -> Duration {
        self.gap() * self.nth
    }

    fn gap(&self) -> Duration {
        self.inputs.gap().unwrap_or(self.period)
    }

    fn adapt(&mut self) {
        let gap = self.gap();
        let (Some(median), Some(longest)) = (self.taken.median(), self.taken.longest()) else {
            self.nth = believed(self.taken.at_most(self.estimate), gap);
            return;
        };
        let (up, down) = (periods(median, gap), periods(longest.mul_f64(MARGIN), gap));
        if up > self.nth || down < self.nth {
            self.nth = up.max(down.min(self.nth));
        }
    }
}

/// The n before anything is measured.
fn believed(estimate: Option<Duration>, period: Duration) -> u32 {
    let estimate = estimate.filter(|estimate| *estimate > period * BELIEVED_PERIODS);
    estimate.map_or(1, |estimate| periods(estimate, period))
}

/// Whole periods of the work, at least one.
pub fn periods(taken: Duration, period: Duration) -> u32 {
    let periods = taken.as_nanos().div_ceil(period.as_nanos().max(1));
    // It saturates.
    u32::try_from(periods).unwrap_or(u32::MAX).max(1)
}

#[cfg(test)]
mod tests;
