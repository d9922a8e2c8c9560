//! The figures of a report.

use serde::{Deserialize, Serialize};

/// The nodes' default `frame_period` \[s\].
const USUAL_PERIOD_S: f64 = 0.2;
/// A camera is too slow for it from this many times the period on; less is jitter of a mean over a short bag.
const SLOWER: f64 = 1.25;

/// Fewest predictions that are judged.
const LEAST: u64 = 8;
/// PSNR of the held frame beyond which nothing moves \[dB\]: 40 dB is an error of 1 % of the full scale.
const STILL_DB: f64 = 40.0;

/// A whole report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// What was scored: the live topics, or a bag.
    pub source: String,
    /// Name of the transition model.
    pub model: String,
    /// SHA-256 of its weights and configuration.
    pub model_hash: String,
    /// Model steps of a rollout.
    pub horizon: u32,
    /// Time of one model step \[s\].
    pub step_period_s: f64,
    /// Camera frames seen.
    pub frames: u64,
    /// Mean rate of the camera frames, by their stamps \[Hz\].
    pub frame_rate_hz: f64,
    /// Observations that predictions were made from.
    pub observations: u64,
    /// One entry a step, from k = 1.
    pub steps: Vec<StepFigures>,
    /// The planner's, where it planned.
    pub plans: Option<PlanFigures>,
    /// What the nodes dropped, and why.
    pub drops: Vec<Drops>,
    /// What the nodes left out by choice, being slower than their input, and why.
    #[serde(default)]
    pub skips: Vec<Drops>,
}

impl Report {
    /// Why the predictions are not to be trusted, where the persistence baseline is as close to what came one step
    /// ahead.
    #[must_use]
    pub fn doubt(&self) -> Option<String> {
        let first = self.steps.iter().find(|step| step.step == 1)?;
        let is_scored = first.predictions.max(first.compared) >= LEAST;
        let ratio = first
            .latent_error_ratio
            .filter(|ratio| is_scored && *ratio >= 1.0);
        let pictures = first.psnr_db.zip(first.persistence_psnr_db);
        // Where nothing moves, holding still cannot be beaten.
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
            "The predictions are no better than the persistence baseline, the last frame repeated ({why}): the model \
             may not be trained on such pictures, or the actions may not be this robot's."
        ))
    }

    /// The frames and their rate, and what could be the reason that there is no prediction: a rate that is no usual one
    /// of a model, and what the nodes left out.
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
        for line in self.left_out() {
            text.push_str(&format!("; {line}"));
        }
        text
    }

    /// What the nodes dropped, and what they left out by choice: a line for each node and reason.
    pub(crate) fn left_out(&self) -> impl Iterator<Item = String> {
        let drops = self.drops.iter().map(|drops| ("dropped", drops));
        let skips = self.skips.iter().map(|skips| ("left out by choice", skips));
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
    /// Predictions of this step that arrived.
    pub predictions: u64,
    /// Predictions of this step that others of the same observation have and this one lacks.
    pub missing: u64,
    /// Pictures compared with the frame of their moment.
    #[serde(rename = "n")]
    pub compared: u64,
    /// Mean PSNR of the predicted pictures \[dB\]; each is capped at [`PSNR_CAP_DB`](super::scorer::PSNR_CAP_DB).
    pub psnr_db: Option<f64>,
    /// Mean SSIM of the predicted pictures.
    pub ssim: Option<f64>,
    /// The same PSNR of the last observed frame, repeated \[dB\].
    pub persistence_psnr_db: Option<f64>,
    /// The same SSIM of the last observed frame, repeated.
    pub persistence_ssim: Option<f64>,
    /// Mean latent squared error of the predictions over that of persistence: below 1 the model beats standing still.
    pub latent_error_ratio: Option<f64>,
    /// From the capture of the observed frame until the step was ready to be sent.
    pub ready_latency: Option<Percentiles>,
    /// From the capture of the observed frame until the step was here.
    pub received_latency: Option<Percentiles>,
}

/// The planner's figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanFigures {
    /// Plans that arrived.
    pub plans: u64,
    /// How many of them the deadline cut short.
    pub deadline_cuts: u64,
    /// Planning time.
    pub time_taken: Option<Percentiles>,
    /// Cost of the first plan.
    pub first_cost: f64,
    /// Cost of the last plan.
    pub last_cost: f64,
}

/// Percentiles of a time \[ms\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Samples.
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

/// What a node dropped, or left out by choice, for one reason.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Drops {
    /// The node.
    pub node: String,
    /// Why, in the node's words.
    pub reason: String,
    /// How many, since the node began.
    pub total: u64,
}
