//! The figures of a report.

use serde::{Deserialize, Serialize};

/// The nodes' default `frame_period` \[s\].
const USUAL_PERIOD_S: f64 = 0.2;
/// A camera is too slow if its period is longer than the model's by this factor; less is jitter in the mean of a short
/// bag.
const SLOWER: f64 = 1.25;

/// The fewest predictions that allow a judgement.
const LEAST: u64 = 8;
/// PSNR of the repeated last frame above which the scene is still \[dB\]: 40 dB is an error of 1 % of the full scale.
const STILL_DB: f64 = 40.0;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The source of the data: the live topics or a bag.
    pub source: String,
    /// Name of the transition model.
    pub model: String,
    /// SHA-256 of its weights and configuration.
    pub model_hash: String,
    /// Model steps of a rollout.
    pub horizon: u32,
    /// Time of one model step \[s\].
    pub step_period_s: f64,
    /// Camera frames.
    pub frames: u64,
    /// Mean rate of the camera frames, by their stamps \[Hz\].
    pub frame_rate_hz: f64,
    /// Observations with predictions.
    pub observations: u64,
    /// One entry per step, from k = 1.
    pub steps: Vec<StepFigures>,
    /// Of the planner; `None` without plans.
    pub plans: Option<PlanFigures>,
    /// Messages that the nodes dropped.
    pub drops: Vec<Drops>,
    /// Messages that the nodes skipped on purpose because they are slower than their input.
    #[serde(default)]
    pub skips: Vec<Drops>,
}

impl Report {
    /// Why not to trust the predictions, if the persistence baseline is as close one step ahead.
    #[must_use]
    pub(crate) fn doubt(&self) -> Option<String> {
        let first = self.steps.iter().find(|step| step.step == 1)?;
        let is_scored = first.predictions.max(first.compared) >= LEAST;
        let ratio = first
            .latent_error_ratio
            .filter(|ratio| is_scored && *ratio >= 1.0);
        let pictures = first.psnr_db.zip(first.persistence_psnr_db);
        // in a still scene, no prediction can beat repetition
        if pictures.is_some_and(|(_, held)| held > STILL_DB) {
            return None;
        }
        let is_compared = first.compared >= LEAST;
        let pictures = pictures.filter(|(predicted, held)| is_compared && predicted < held);
        let why = match (pictures, ratio) {
            (Some((predicted, held)), _) => {
                format!("PSNR {predicted:.1} dB one step ahead against {held:.1} dB")
            }
            (None, Some(ratio)) => {
                format!("squared latent error {ratio:.2} times as large one step ahead")
            }
            (None, None) => return None,
        };
        Some(format!(
            "The predictions are no better than the persistence baseline, which repeats the last frame ({why}): the \
             training may have been too short or of other pictures, or the actions may not be this robot's."
        ))
    }

    /// Number and rate of the frames, with possible reasons for missing predictions: a rate unusual for models, and
    /// skipped messages.
    #[must_use]
    pub fn frames_in_words(&self) -> String {
        let (frames, rate) = (self.frames, self.frame_rate_hz);
        if rate <= 0.0 {
            return format!("{frames} frame(s) arrived");
        }
        let mut text = format!("{frames} frames arrived at {rate:.2} Hz");
        if rate * USUAL_PERIOD_S * SLOWER < 1.0 {
            text.push_str(&format!(
                "; encoder, predictor and planner expect one every \"frame_period\" ({USUAL_PERIOD_S} s by default): for a \
                 slower camera, set that parameter of all three to {:.3} s",
                1.0 / rate
            ));
        }
        for line in self.losses() {
            text.push_str(&format!("; {line}"));
        }
        text
    }

    /// Dropped and skipped messages: a line for each node and reason.
    pub(crate) fn losses(&self) -> impl Iterator<Item = String> {
        let drops = self.drops.iter().map(|drops| ("dropped", drops));
        let skips = self.skips.iter().map(|skips| ("skipped on purpose", skips));
        drops.chain(skips).map(
            |(
                how,
                Drops {
                    node,
                    reason,
                    total,
                },
            )| format!("{how} by {node}: {total} ({reason})"),
        )
    }
}

/// The figures of step k.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepFigures {
    /// k: model steps after the observation.
    pub step: u32,
    pub predictions: u64,
    /// Predictions of this step that are missing although their observation has others.
    pub missing: u64,
    /// Pictures compared with the frame of the same time.
    #[serde(rename = "n")]
    pub compared: u64,
    /// Mean PSNR of the predicted pictures \[dB\]; each is capped at [`PSNR_CAP_DB`](super::scorer::PSNR_CAP_DB).
    pub psnr_db: Option<f64>,
    /// Mean SSIM of the predicted pictures.
    pub ssim: Option<f64>,
    /// Mean PSNR of the repeated last observed frame \[dB\].
    pub persistence_psnr_db: Option<f64>,
    /// Mean SSIM of the repeated last observed frame.
    pub persistence_ssim: Option<f64>,
    /// Mean squared latent error of the predictions divided by that of persistence: below 1 the model beats repetition.
    pub latent_error_ratio: Option<f64>,
    /// Time from the capture of the observed frame until the step was ready to be sent.
    pub ready_latency: Option<Percentiles>,
    /// Time from the capture of the observed frame until the step arrived.
    pub received_latency: Option<Percentiles>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanFigures {
    pub plans: u64,
    /// Plans that the deadline cut short.
    pub deadline_cuts: u64,
    /// Planning time.
    pub time_taken: Option<Percentiles>,
    /// Cost of the first plan.
    pub first_cost: f64,
    /// Cost of the last plan.
    pub last_cost: f64,
}

/// Percentiles of a duration \[ms\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Number of samples.
    pub n: u64,
    /// Median.
    pub p50_ms: f64,
    /// 95th percentile.
    pub p95_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
    /// The longest.
    pub max_ms: f64,
}

/// Messages that a node dropped or skipped for one reason.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Drops {
    pub node: String,
    /// As the node names it.
    pub reason: String,
    /// How many since the node started.
    pub total: u64,
}
