//! Which rollout is shown: the one with the most motion, of those whose every step was seen.

use image::RgbImage;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use wm_model::metrics::psnr;

/// Rollouts in the making: a horizon of 64 steps of two camera frames, and some room.
const OPEN_LIMIT: usize = 160;

/// A rollout and what really happened.
#[derive(Clone, Debug)]
pub struct ShownRollout {
    /// Stamp of the observation \[ns\].
    pub observed_ns: i64,
    /// The frame that it started from.
    pub observed: Arc<RgbImage>,
    /// By step from k = 1: the real frame and the predicted picture.
    pub steps: Vec<(Arc<RgbImage>, Arc<RgbImage>)>,
}

#[derive(Debug)]
struct Open {
    observed: Arc<RgbImage>,
    steps: BTreeMap<u32, (Arc<RgbImage>, Arc<RgbImage>)>,
}

#[derive(Debug, Default)]
pub(super) struct Rollouts {
    observations: u64,
    /// Stamps of the last observations, to count each once.
    recent: VecDeque<i64>,
    open: BTreeMap<i64, Open>,
    best: Option<(f64, ShownRollout)>,
}

impl Rollouts {
    /// Counts the observations that predictions start from.
    pub fn observed(&mut self, observed_ns: i64) {
        if self.recent.contains(&observed_ns) {
            return;
        }
        if self.recent.len() == OPEN_LIMIT {
            self.recent.pop_front();
        }
        self.recent.push_back(observed_ns);
        self.observations += 1;
    }

    pub fn observations(&self) -> u64 {
        self.observations
    }

    /// A picture and the frame of its moment.
    pub fn picture(
        &mut self,
        observed_ns: i64,
        step: u32,
        horizon: u32,
        observed: &Arc<RgbImage>,
        real: &Arc<RgbImage>,
        predicted: &Arc<RgbImage>,
    ) {
        let new = || Open {
            observed: Arc::clone(observed),
            steps: BTreeMap::new(),
        };
        let open = self.open.entry(observed_ns).or_insert_with(new);
        open.steps
            .insert(step, (Arc::clone(real), Arc::clone(predicted)));
        if open.steps.len() == horizon as usize
            && let Some(whole) = self.open.remove(&observed_ns)
        {
            self.consider(observed_ns, whole);
        }
        while self.open.len() > OPEN_LIMIT {
            self.open.pop_first();
        }
    }

    pub fn best(&self) -> Option<&ShownRollout> {
        self.best.as_ref().map(|(_, rollout)| rollout)
    }

    pub fn flush(&mut self) {
        self.open.clear();
        self.recent.clear();
    }

    fn consider(&mut self, observed_ns: i64, whole: Open) {
        // motion: how unlike the observation the frames became
        let likeness = whole
            .steps
            .values()
            .filter_map(|(real, _)| psnr(&whole.observed, real).ok());
        let stillness: f64 = likeness
            .map(|decibel| decibel.min(super::PSNR_CAP_DB))
            .sum();
        if self.best.as_ref().is_none_or(|(best, _)| stillness < *best) {
            let steps = whole.steps.into_values().collect();
            self.best = Some((
                stillness,
                ShownRollout {
                    observed_ns,
                    observed: whole.observed,
                    steps,
                },
            ));
        }
    }
}
