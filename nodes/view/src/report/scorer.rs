//! Turns frames, predictions and pictures into figures.

mod rollout;
mod step;

use super::{
    figures::{Drops, PlanFigures, Report},
    frames::Frames,
    histogram::Times,
    pairing::{Awaited, Pairing, Pairings},
};
use image::RgbImage;
use rollout::Rollouts;
pub(crate) use rollout::ShownRollout;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use step::StepScore;
use wm_model::Fit;
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    wm_msgs::{Plan, Prediction, PredictionError},
};

/// The cap on one picture's PSNR \[dB\]. Rounding to 8 bits alone gives 58.9 dB, so beyond the cap pictures are equal,
/// and an infinite value would decide a mean.
pub(crate) const PSNR_CAP_DB: f64 = 60.0;

/// The most pictures that wait for their frame.
const WAITING_LIMIT: usize = 512;

/// The drop reason of a predicted picture that arrived after its frame was gone.
pub(super) const LATE_PICTURE: &str = "late_picture";

/// Squared normalised latent change below which the scene is still and persistence cannot be beaten; the same as the
/// predictor's.
const STILL: f32 = 1e-3;

/// The most steps of a rollout.
const STEP_LIMIT: u32 = 64;

/// A larger distance from the newest stamp means that time jumped \[ns\].
const JUMP_NS: u64 = 1_000_000_000;

/// A predicted picture that waits for the frame of its time.
#[derive(Clone, Debug)]
struct Waiting {
    prediction: Awaited,
    picture: Arc<RgbImage>,
}

/// A report in progress.
#[derive(Debug)]
pub struct Scorer {
    frames: Frames,
    frame_count: u64,
    /// The sum of the distances between consecutive frames.
    frame_span_ns: i64,
    frame_distances: u64,
    pairings: Pairings,
    waiting: VecDeque<Waiting>,
    steps: BTreeMap<u32, StepScore>,
    rollouts: Rollouts,
    model: String,
    model_hash: String,
    horizon: u32,
    period_ns: i64,
    plans: u64,
    deadline_cuts: u64,
    plan_times: Times,
    first_cost: f64,
    last_cost: f64,
    /// By node and reason.
    drops: BTreeMap<(String, String), u64>,
    /// Skipped on purpose, by node and reason.
    skips: BTreeMap<(String, String), u64>,
    last_error_ratio: Option<f32>,
}

impl Default for Scorer {
    fn default() -> Self {
        Self {
            frames: Frames::default(),
            frame_count: 0,
            frame_span_ns: 0,
            frame_distances: 0,
            pairings: Pairings::default(),
            waiting: VecDeque::new(),
            steps: BTreeMap::new(),
            rollouts: Rollouts::default(),
            model: String::new(),
            model_hash: String::new(),
            horizon: 0,
            period_ns: 0,
            plans: 0,
            deadline_cuts: 0,
            plan_times: Times::new(),
            first_cost: 0.0,
            last_cost: 0.0,
            drops: BTreeMap::new(),
            skips: BTreeMap::new(),
            last_error_ratio: None,
        }
    }
}

impl Scorer {
    /// A camera frame, captured at `stamp_ns`.
    pub(crate) fn frame(&mut self, stamp_ns: i64, frame: RgbImage) {
        if self
            .frames
            .newest_ns()
            .is_some_and(|newest_ns| stamp_ns.abs_diff(newest_ns) > JUMP_NS)
        {
            self.flush();
        }
        let newest_ns = self.frames.newest_ns();
        if !self.frames.insert(stamp_ns, frame) {
            return;
        }
        self.frame_count += 1;
        if let Some(distance_ns) = newest_ns
            .map(|newest_ns| stamp_ns - newest_ns)
            .filter(|distance| *distance > 0)
        {
            self.frame_span_ns = self.frame_span_ns.saturating_add(distance_ns);
            self.frame_distances += 1;
        }
        let due = std::mem::take(&mut self.waiting);
        for waiting in due {
            self.compare_or_wait(waiting);
        }
    }

    /// Sets how the model frames another aspect ratio; until then frames are stretched.
    pub(crate) fn fit(&mut self, fit: Fit) {
        self.frames.set_fit(fit);
    }

    /// `arrived_ns`: on the clock of the stamps.
    pub(crate) fn prediction(&mut self, prediction: &Prediction, arrived_ns: i64) {
        // Messages within this process were not decoded, so their times may be invalid.
        let period_ns = prediction.step_period.checked_nanos().unwrap_or(0);
        let times = [
            prediction.header.stamp,
            prediction.observed_stamp,
            prediction.ready_stamp,
        ];
        let is_invalid = times.iter().any(|time| time.checked_nanos().is_err());
        if prediction.step == 0 || prediction.step > STEP_LIMIT || period_ns <= 0 || is_invalid {
            *self
                .drops
                .entry(("report".to_owned(), "bad_prediction".to_owned()))
                .or_default() += 1;
            return;
        }
        self.model.clone_from(&prediction.model);
        self.model_hash.clone_from(&prediction.model_hash);
        self.horizon = prediction.horizon.min(STEP_LIMIT);
        self.period_ns = period_ns;
        let observed_ns = prediction.observed_stamp.to_nanos();
        self.steps.entry(prediction.step).or_default().prediction(
            prediction
                .ready_stamp
                .to_nanos()
                .saturating_sub(observed_ns),
            arrived_ns.saturating_sub(observed_ns),
        );
        self.rollouts.observed(observed_ns);
        self.pairings.predicted(Awaited {
            stamp_ns: prediction.header.stamp.to_nanos(),
            observed_ns,
            step: prediction.step,
            period_ns: self.period_ns,
            arrived_ns,
        });
    }

    /// The picture of a prediction for the time `stamp_ns`. A picture whose prediction is unclear ([`Pairings`]) is not
    /// scored.
    pub(crate) fn picture(&mut self, stamp_ns: i64, picture: RgbImage, arrived_ns: i64) {
        let prediction = match self.pairings.pictured(stamp_ns, arrived_ns) {
            Pairing::Found(prediction) => prediction,
            Pairing::Late => {
                let late = ("report".to_owned(), LATE_PICTURE.to_owned());
                *self.drops.entry(late).or_default() += 1;
                return;
            }
            Pairing::Unknown => return,
        };
        self.frames.set_size(&picture);
        self.compare_or_wait(Waiting {
            prediction,
            picture: Arc::new(picture),
        });
    }

    pub(crate) fn error(&mut self, error: &PredictionError) {
        if error.step == 0 || error.step > STEP_LIMIT {
            return;
        }
        let is_moving = error.persistence_mse > STILL;
        if error.step == 1 && error.ratio.is_finite() && is_moving {
            self.last_error_ratio = Some(error.ratio);
        }
        self.steps
            .entry(error.step)
            .or_default()
            .latent_error(error.mse, error.persistence_mse);
    }

    pub(crate) fn plan(&mut self, plan: &Plan) {
        if self.plans == 0 {
            self.first_cost = f64::from(plan.cost);
        }
        self.plans += 1;
        self.deadline_cuts += u64::from(plan.deadline_cut);
        self.plan_times.record(plan.time_taken.to_nanos());
        self.last_cost = f64::from(plan.cost);
    }

    /// Takes the counts of dropped and skipped messages.
    pub(crate) fn diagnostics(&mut self, array: &DiagnosticArray) {
        for status in &array.status {
            for pair in &status.values {
                let Some((what, reason)) =
                    (pair.key.strip_suffix(" [total]")).and_then(|key| key.split_once(": "))
                else {
                    continue;
                };
                let counts = match what {
                    "dropped" => &mut self.drops,
                    "skipped" => &mut self.skips,
                    _ => continue,
                };
                if let Ok(total) = pair.value.parse() {
                    counts.insert((status.name.clone(), reason.to_owned()), total);
                }
            }
        }
    }

    /// Whether nothing was received for a report.
    #[must_use]
    pub(crate) fn is_empty(&self) -> bool {
        self.frame_count == 0 && self.steps.is_empty() && self.plans == 0
    }

    #[must_use]
    pub fn is_without_predictions(&self) -> bool {
        self.steps.is_empty()
    }

    /// How many messages the nodes have dropped.
    #[must_use]
    pub(crate) fn drop_count(&self) -> u64 {
        self.drops.values().sum()
    }

    /// The error ratio of the last scored prediction of k = 1.
    #[must_use]
    pub(crate) fn last_error_ratio(&self) -> Option<f32> {
        self.last_error_ratio
    }

    /// Of the rollouts with the most steps, the one with the most motion.
    #[must_use]
    pub(crate) fn shown_rollout(&self) -> Option<&ShownRollout> {
        self.rollouts.best()
    }

    #[must_use]
    pub(crate) fn report(&self, source: &str) -> Report {
        let observations = self.rollouts.observations();
        let frame_rate_hz = match self.frame_span_ns {
            0 => 0.0,
            span_ns => self.frame_distances as f64 / (span_ns as f64 / 1e9),
        };
        let steps = self
            .steps
            .iter()
            .map(|(step, score)| score.figures(*step, observations));
        Report {
            source: source.to_owned(),
            model: self.model.clone(),
            model_hash: self.model_hash.clone(),
            horizon: self.horizon,
            step_period_s: self.period_ns as f64 / 1e9,
            frames: self.frame_count,
            frame_rate_hz,
            observations,
            steps: steps.collect(),
            plans: (self.plans > 0).then(|| PlanFigures {
                plans: self.plans,
                deadline_cuts: self.deadline_cuts,
                time_taken: self.plan_times.percentiles(),
                first_cost: self.first_cost,
                last_cost: self.last_cost,
            }),
            drops: counted(&self.drops),
            skips: counted(&self.skips),
        }
    }

    /// Compares a picture with the frame of the same time, or waits for that frame.
    fn compare_or_wait(&mut self, waiting: Waiting) {
        let prediction = waiting.prediction;
        // tolerates an error of an eighth of a step; the next frame is further away
        let tolerance_ns = prediction.period_ns / 8;
        let Some(real) = self.frames.nearest(prediction.stamp_ns, tolerance_ns) else {
            let has_passed =
                |newest_ns| prediction.stamp_ns.saturating_add(tolerance_ns) < newest_ns;
            if !self.frames.newest_ns().is_some_and(has_passed) {
                if self.waiting.len() == WAITING_LIMIT {
                    self.waiting.pop_front();
                }
                self.waiting.push_back(waiting);
            }
            return;
        };
        let Some(observed) = self.frames.nearest(prediction.observed_ns, tolerance_ns) else {
            return;
        };
        let score = self.steps.entry(prediction.step).or_default();
        score.compare(&waiting.picture, real, observed);
        self.rollouts.picture(
            prediction.observed_ns,
            prediction.step,
            self.horizon,
            observed,
            real,
            &waiting.picture,
        );
    }

    /// Time jumped: drops everything that waits.
    fn flush(&mut self) {
        self.frames.clear();
        self.pairings.clear();
        self.waiting.clear();
        self.rollouts.flush();
    }
}

fn counted(counts: &BTreeMap<(String, String), u64>) -> Vec<Drops> {
    let some = counts.iter().filter(|(_, total)| **total > 0);
    some.map(|((node, reason), total)| Drops {
        node: node.clone(),
        reason: reason.clone(),
        total: *total,
    })
    .collect()
}

#[cfg(test)]
mod tests;
