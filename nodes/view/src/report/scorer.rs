//! Frames, predictions and pictures in, figures out.

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
pub use rollout::ShownRollout;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use step::StepScore;
use wm_model::Fit;
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    wm_msgs::{Plan, Prediction, PredictionError},
};

/// PSNR of one picture counts as at most this \[dB\]: the noise of rounding to 8 bits alone is at 58.9 dB, so beyond
/// it two pictures are the same, and an infinite one would decide a mean.
pub const PSNR_CAP_DB: f64 = 60.0;

/// Pictures that wait for their frame.
const WAITING_LIMIT: usize = 512;

/// Why a predicted picture is not compared: it came when its frame was gone.
pub(super) const LATE_PICTURE: &str = "late_picture";

/// Squared latent change, normalised, below which nothing moves, so that holding still cannot be beaten; as the predictor's.
const STILL: f32 = 1e-3;

/// Steps of a rollout that are distinguished.
const STEP_LIMIT: u32 = 64;

/// A stamp this far from the newest means that time jumped \[ns\].
const JUMP_NS: u64 = 1_000_000_000;

/// A predicted picture whose moment is still to come.
#[derive(Clone, Debug)]
struct Waiting {
    prediction: Awaited,
    picture: Arc<RgbImage>,
}

/// The state of a report in the making.
#[derive(Debug)]
pub struct Scorer {
    frames: Frames,
    frame_count: u64,
    /// Sum and number of the distances from one frame to the next.
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
    /// What was left out by choice.
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
    pub fn frame(&mut self, stamp_ns: i64, frame: RgbImage) {
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

    /// How the model takes frames of another aspect than its own; they are stretched until this is known.
    pub fn fit(&mut self, fit: Fit) {
        self.frames.set_fit(fit);
    }

    /// A prediction that arrived at `arrived_ns` (the clock of the stamps).
    pub fn prediction(&mut self, prediction: &Prediction, arrived_ns: i64) {
        // A message of a node of this process was not decoded.
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

    /// The picture of a prediction for the moment `stamp_ns`, arrived at `arrived_ns`. One of which it cannot be told of
    /// which prediction it is ([`Pairings`]) is not scored.
    pub fn picture(&mut self, stamp_ns: i64, picture: RgbImage, arrived_ns: i64) {
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

    /// The latent error of a prediction.
    pub fn error(&mut self, error: &PredictionError) {
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

    /// A plan.
    pub fn plan(&mut self, plan: &Plan) {
        if self.plans == 0 {
            self.first_cost = f64::from(plan.cost);
        }
        self.plans += 1;
        self.deadline_cuts += u64::from(plan.deadline_cut);
        self.plan_times.record(plan.time_taken.to_nanos());
        self.last_cost = f64::from(plan.cost);
    }

    /// The nodes' diagnostics: their counts of what they dropped and of what they left out by choice.
    pub fn diagnostics(&mut self, array: &DiagnosticArray) {
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

    /// Whether nothing was seen so far that a report tells of.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frame_count == 0 && self.steps.is_empty() && self.plans == 0
    }

    /// Whether no prediction was seen so far.
    #[must_use]
    pub fn is_without_predictions(&self) -> bool {
        self.steps.is_empty()
    }

    /// Camera frames seen so far.
    #[must_use]
    pub fn frame_count(&self) -> u64 {
        self.frame_count
    }

    /// Everything that the nodes have dropped so far.
    #[must_use]
    pub fn drop_count(&self) -> u64 {
        self.drops.values().sum()
    }

    /// The error ratio of the last scored prediction of k = 1.
    #[must_use]
    pub fn last_error_ratio(&self) -> Option<f32> {
        self.last_error_ratio
    }

    /// The rollout with the most motion of those of which the most steps were seen.
    #[must_use]
    pub fn shown_rollout(&self) -> Option<&ShownRollout> {
        self.rollouts.best()
    }

    /// The figures so far.
    #[must_use]
    pub fn report(&self, source: &str) -> Report {
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
        // a stamp that is off by an eighth of a step is still that moment; the next frame is further away
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

    /// Time jumped: nothing that waits will be matched any more.
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
