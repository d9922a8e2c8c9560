//! Single numbers, for plots without wm's messages.

use anyhow::Result;
use wm_msgs::{
    std_msgs::Float64,
    wm_msgs::{Prediction, PredictionError},
};
use wm_ros::{Publisher, Qos};

use super::{Fit, Trust};

/// The steps of a rollout of the default horizon, which arrive at once.
const QOS: Qos = Qos::reliable(16);

wm_ros::endpoints! {
    /// Single numbers, for plots.
    #[derive(Clone)]
    pub(super) struct Plots {
        /// The ratio of prediction_error, one model step ahead: below 1 the model beats the persistence baseline.
        ratio_k1: Publisher<Float64> = "prediction_error/ratio_k1", qos(QOS);
        /// The same, four steps ahead.
        ratio_k4: Publisher<Float64> = "prediction_error/ratio_k4", qos(QOS);
        /// The same, eight steps ahead.
        ratio_k8: Publisher<Float64> = "prediction_error/ratio_k8", qos(QOS);
        /// From the capture of the observed frame until its first predicted step is ready [s].
        latency_k1: Publisher<Float64> = "prediction_latency/k1", qos(QOS);
        /// The same, until its fourth step is.
        latency_k4: Publisher<Float64> = "prediction_latency/k4", qos(QOS);
        /// The same, until its eighth step is.
        latency_k8: Publisher<Float64> = "prediction_latency/k8", qos(QOS);
        /// The calibration's factor one step ahead: by what the predicted motion is multiplied.
        calibration_k1: Publisher<Float64> = "calibration/factor_k1", qos(QOS);
        /// The same, four steps ahead.
        calibration_k4: Publisher<Float64> = "calibration/factor_k4", qos(QOS);
        /// The same, eight steps ahead.
        calibration_k8: Publisher<Float64> = "calibration/factor_k8", qos(QOS);
        /// Part of the squared motion of the last scored predictions, one step ahead, that they explain after calibration: 1 is
        /// perfect, 0 the persistence baseline.
        explained: Publisher<Float64> = "calibration/explained", qos(QOS);
        /// The ratio one step ahead over the last 5 s, before calibration: from 1 on, /diagnostics warns while something
        /// moves.
        trust_ratio: Publisher<Float64> = "trust/error_ratio", qos(QOS);
        /// Part of the latents' values that are far from the training's, over the last 5 s: above 0.02, /diagnostics
        /// warns.
        trust_far: Publisher<Float64> = "trust/unlike_training", qos(QOS);
    }
}

impl Plots {
    /// The prediction is ready.
    pub(super) fn predicted(&self, prediction: &Prediction) -> Result<()> {
        let plot = match prediction.step {
            1 => &self.latency_k1,
            4 => &self.latency_k4,
            8 => &self.latency_k8,
            _ => return Ok(()),
        };
        let ready_ns = prediction.ready_stamp.to_nanos();
        let taken_ns = ready_ns.saturating_sub(prediction.observed_stamp.to_nanos());
        // Exact up to 104 days.
        show(plot, taken_ns as f64 / 1e9)
    }

    /// A rollout had this calibration.
    pub(super) fn calibrated(&self, fits: &[Fit]) -> Result<()> {
        let plots = [
            &self.calibration_k1,
            &self.calibration_k4,
            &self.calibration_k8,
        ];
        for (plot, k) in plots.into_iter().zip([1, 4, 8]) {
            if let Some(fit) = fits.get(k - 1) {
                show(plot, fit.factor)?;
            }
        }
        match fits.first().and_then(|fit| fit.explained) {
            Some(explained) => show(&self.explained, explained),
            None => Ok(()),
        }
    }

    /// The prediction was compared with the real frame.
    pub(super) fn scored(&self, error: &PredictionError) -> Result<()> {
        let plot = match error.step {
            1 => &self.ratio_k1,
            4 => &self.ratio_k4,
            8 => &self.ratio_k8,
            _ => return Ok(()),
        };
        show(plot, error.ratio.into())
    }

    /// A frame was observed.
    pub(super) fn trust(&self, trust: Measured) -> Result<()> {
        if let Some(ratio) = trust.ratio {
            show(&self.trust_ratio, ratio)?;
        }
        if let Some(part) = trust.far {
            show(&self.trust_far, part.into())?;
        }
        Ok(())
    }
}

/// Skips ratios to zero: if the camera's picture does not change, the persistence baseline has no error.
fn show(plot: &Publisher<Float64>, data: f64) -> Result<()> {
    match data.is_finite() {
        true => Ok(plot.publish(&Float64 { data })?),
        false => Ok(()),
    }
}

/// The figures of the predictions' quality that are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    ratio: Option<f64>,
    far: Option<f32>,
}

impl From<&Trust> for Measured {
    fn from(trust: &Trust) -> Self {
        Self {
            ratio: trust.ratio(),
            far: trust.far(),
        }
    }
}
