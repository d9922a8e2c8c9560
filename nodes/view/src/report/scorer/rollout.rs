//! Chooses the rollout to show: of those with the most steps, the one with the most motion.

use image::RgbImage;
use std::cmp::Ordering;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use wm_metrics::images::psnr;

/// The most open rollouts: a horizon of 64 steps of two camera frames, and some room.
const OPEN_LIMIT: usize = 160;

/// A rollout and the real frames.
#[derive(Clone, Debug)]
pub(crate) struct ShownRollout {
    /// The frame that it starts from.
    pub observed: Arc<RgbImage>,
    /// By k: the real frame and the predicted picture. A decoder under load skips steps.
    pub steps: BTreeMap<u32, (Arc<RgbImage>, Arc<RgbImage>)>,
}

impl ShownRollout {
    /// How similar the frames stayed to the observation, as mean PSNR \[dB\]: less means more motion.
    fn stillness_db(&self) -> f64 {
        let likeness = self
            .steps
            .values()
            .filter_map(|(real, _)| psnr(&self.observed, real).ok());
        let sum: f64 = likeness
            .map(|decibel| decibel.min(super::PSNR_CAP_DB))
            .sum();
        sum / self.steps.len().max(1) as f64
    }

    fn is_better_than(&self, other: &Self) -> bool {
        match self.steps.len().cmp(&other.steps.len()) {
            Ordering::Greater => true,
            Ordering::Equal => self.stillness_db() < other.stillness_db(),
            Ordering::Less => false,
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct Rollouts {
    observations: u64,
    /// Stamps of the last observations, to count each once.
    recent: VecDeque<i64>,
    /// By stamp of the observation.
    open: BTreeMap<i64, ShownRollout>,
    /// The best closed rollout.
    best: Option<ShownRollout>,
}

impl Rollouts {
    /// Counts the observations that predictions start from.
    pub(crate) fn observed(&mut self, observed_ns: i64) {
        if self.recent.contains(&observed_ns) {
            return;
        }
        if self.recent.len() == OPEN_LIMIT {
            self.recent.pop_front();
        }
        self.recent.push_back(observed_ns);
        self.observations += 1;
    }

    pub(crate) fn observations(&self) -> u64 {
        self.observations
    }

    /// Adds a picture and the frame of the same time.
    pub(crate) fn picture(
        &mut self,
        observed_ns: i64,
        step: u32,
        horizon: u32,
        observed: &Arc<RgbImage>,
        real: &Arc<RgbImage>,
        predicted: &Arc<RgbImage>,
    ) {
        let new = || ShownRollout {
            observed: Arc::clone(observed),
            steps: BTreeMap::new(),
        };
        let open = self.open.entry(observed_ns).or_insert_with(new);
        open.steps
            .insert(step, (Arc::clone(real), Arc::clone(predicted)));
        if open.steps.len() == horizon as usize
            && let Some(whole) = self.open.remove(&observed_ns)
        {
            self.consider(whole);
        }
        while self.open.len() > OPEN_LIMIT
            && let Some((_, oldest)) = self.open.pop_first()
        {
            self.consider(oldest);
        }
    }

    pub(crate) fn best(&self) -> Option<&ShownRollout> {
        let candidates = self.best.iter().chain(self.open.values());
        candidates.reduce(|best, next| {
            if next.is_better_than(best) {
                next
            } else {
                best
            }
        })
    }

    pub(crate) fn flush(&mut self) {
        for (_, rollout) in std::mem::take(&mut self.open) {
            self.consider(rollout);
        }
        self.recent.clear();
    }

    fn consider(&mut self, rollout: ShownRollout) {
        let is_better = |best| rollout.is_better_than(best);
        if self.best.as_ref().is_none_or(is_better) {
            self.best = Some(rollout);
        }
    }
}
