//! Finds the prediction of a predicted picture.
//!
//! A picture carries only the predicted time, which predictions of several observations share. The decoder decodes one
//! rollout after the other, in order of their observations, and the steps of a rollout in order. So a picture belongs to
//! the rollout of the last picture, or begins a newer one. Predictions of the same time arrive a model step apart. If a
//! picture arrives within a model step of its prediction, it belongs to the newest rollout that has its time. A later
//! picture is paired only if it continues its rollout without a gap, if one rollout alone has its time, or if its step
//! is that with which the decoder begins its rollouts.

use std::collections::VecDeque;

/// The most predictions that wait for their picture.
const AWAITED_LIMIT: usize = 512;

/// A prediction that waits for its picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Awaited {
    /// The predicted time \[ns\].
    pub stamp_ns: i64,
    /// Stamp of the observation \[ns\].
    pub observed_ns: i64,
    /// k: model steps after the observation.
    pub step: u32,
    /// Duration of a model step \[ns\].
    pub period_ns: i64,
    /// When the prediction arrived \[ns\].
    pub arrived_ns: i64,
}

/// The result for a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pairing {
    /// The picture of this prediction.
    Found(Awaited),
    /// Too late to find its prediction.
    Late,
    /// No prediction has its time.
    Unknown,
}

/// The predictions that wait for their pictures.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pairings {
    awaited: VecDeque<Awaited>,
    /// The prediction of the last picture.
    last: Option<Awaited>,
    /// The lowest k with a picture: that of the first picture of each rollout.
    first_step: Option<u32>,
}

impl Pairings {
    /// A prediction has arrived.
    pub(crate) fn predicted(&mut self, awaited: Awaited) {
        if self.awaited.len() == AWAITED_LIMIT {
            self.awaited.pop_front();
        }
        self.awaited.push_back(awaited);
    }

    /// A picture of the time `stamp_ns` has arrived. Its prediction no longer waits.
    pub(crate) fn pictured(&mut self, stamp_ns: i64, arrived_ns: i64) -> Pairing {
        let found = self.find(stamp_ns, arrived_ns);
        let Some(prediction) = found.and_then(|index| self.awaited.remove(index)) else {
            let is_known = self.awaited.iter().any(|a| a.stamp_ns == stamp_ns);
            return if is_known {
                Pairing::Late
            } else {
                Pairing::Unknown
            };
        };
        self.last = Some(prediction);
        let first_step = self.first_step.unwrap_or(u32::MAX).min(prediction.step);
        self.first_step = Some(first_step);
        Pairing::Found(prediction)
    }

    /// The index of the picture's prediction.
    fn find(&self, stamp_ns: i64, arrived_ns: i64) -> Option<usize> {
        let is_past = |a: &Awaited| {
            let last = self.last.as_ref();
            last.is_some_and(|last| a.observed_ns < last.observed_ns)
        };
        let candidates: Vec<_> = (self.awaited.iter().enumerate())
            .filter(|(_, a)| a.stamp_ns == stamp_ns && !is_past(a))
            .collect();
        let is_in_time = |a: &Awaited| arrived_ns.saturating_sub(a.arrived_ns) <= a.period_ns;
        let continues = |a: &Awaited| {
            self.last.as_ref().is_some_and(|last| {
                a.observed_ns == last.observed_ns && (a.step == last.step + 1 || is_in_time(a))
            })
        };
        let timely = || candidates.iter().filter(|(_, a)| is_in_time(a));
        let begins = |a: &Awaited| Some(a.step) == self.first_step;
        let found = (candidates.iter().find(|(_, a)| continues(a)))
            .or_else(|| timely().min_by_key(|(_, a)| a.step))
            .or_else(|| candidates.iter().find(|(_, a)| begins(a)));
        match (found, candidates.as_slice()) {
            (Some((index, _)), _) | (None, [(index, _)]) => Some(*index),
            (None, _) => None,
        }
    }

    /// The number of waiting predictions.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> usize {
        self.awaited.len()
    }

    /// Time jumped: drops everything that waits.
    pub(crate) fn clear(&mut self) {
        self.awaited.clear();
        self.last = None;
    }
}

#[cfg(test)]
mod tests;
