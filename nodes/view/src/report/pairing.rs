//! Finds the prediction of a predicted picture.
//!
//! A picture carries only the predicted time, which predictions of several observations share. Such predictions arrive
//! a model step apart, a picture within a model step of its prediction, and the pictures of a rollout one after the
//! other. So a picture belongs to the rollout that already had pictures, otherwise to the newest. If it arrives later
//! than a model step, its step k would be a guess.

use std::collections::VecDeque;

/// The most predictions that wait for their picture.
const AWAITED_LIMIT: usize = 512;

/// The most rollouts remembered to have pictures: more than are decoded within one.
const PICTURED_LIMIT: usize = 64;

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
    /// The last observations whose rollouts had a picture.
    pictured: VecDeque<i64>,
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
        let is_its = |awaited: &Awaited| {
            awaited.stamp_ns == stamp_ns
                && arrived_ns.saturating_sub(awaited.arrived_ns) <= awaited.period_ns
        };
        let fresh = || self.awaited.iter().enumerate().filter(|(_, a)| is_its(a));
        let is_pictured = |a: &Awaited| self.pictured.contains(&a.observed_ns);
        let found = fresh()
            .find(|(_, awaited)| is_pictured(awaited))
            .or_else(|| fresh().min_by_key(|(_, awaited)| awaited.step))
            .map(|(index, _)| index);
        let Some(prediction) = found.and_then(|index| self.awaited.remove(index)) else {
            let is_known = self.awaited.iter().any(|a| a.stamp_ns == stamp_ns);
            return if is_known {
                Pairing::Late
            } else {
                Pairing::Unknown
            };
        };
        if !self.pictured.contains(&prediction.observed_ns) {
            if self.pictured.len() == PICTURED_LIMIT {
                self.pictured.pop_front();
            }
            self.pictured.push_back(prediction.observed_ns);
        }
        Pairing::Found(prediction)
    }

    /// The number of waiting predictions.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> usize {
        self.awaited.len()
    }

    /// Time jumped: drops everything that waits.
    pub(crate) fn clear(&mut self) {
        self.awaited.clear();
        self.pictured.clear();
    }
}
