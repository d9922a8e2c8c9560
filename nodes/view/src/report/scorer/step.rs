//! Sums of one step k.

use super::PSNR_CAP_DB;
use crate::report::{figures::StepFigures, histogram::Times};
use image::RgbImage;
use wm_metrics::images::{psnr, ssim};

#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn get(self) -> Option<f64> {
        // counts stay far below 2^52
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

#[derive(Debug)]
pub(super) struct StepScore {
    predictions: u64,
    psnr: Mean,
    ssim: Mean,
    persistence_psnr: Mean,
    persistence_ssim: Mean,
    latent_mse: Mean,
    latent_persistence_mse: Mean,
    ready: Times,
    received: Times,
}

impl Default for StepScore {
    fn default() -> Self {
        Self {
            predictions: 0,
            psnr: Mean::default(),
            ssim: Mean::default(),
            persistence_psnr: Mean::default(),
            persistence_ssim: Mean::default(),
            latent_mse: Mean::default(),
            latent_persistence_mse: Mean::default(),
            ready: Times::new(),
            received: Times::new(),
        }
    }
}

impl StepScore {
    pub(crate) fn prediction(&mut self, ready_after_ns: i64, received_after_ns: i64) {
        self.predictions += 1;
        self.ready.record(ready_after_ns);
        self.received.record(received_after_ns);
    }

    pub(crate) fn latent_error(&mut self, mse: f32, persistence_mse: f32) {
        if mse.is_finite() && persistence_mse.is_finite() {
            self.latent_mse.add(f64::from(mse));
            self.latent_persistence_mse.add(f64::from(persistence_mse));
        }
    }

    /// Scores a picture and the baseline. If sizes differ, which a frame that cannot be resized causes, neither counts.
    pub(crate) fn compare(&mut self, predicted: &RgbImage, real: &RgbImage, observed: &RgbImage) {
        let scores = (
            psnr(predicted, real),
            psnr(observed, real),
            ssim(predicted, real),
            ssim(observed, real),
        );
        if let (
            Ok(predicted_psnr),
            Ok(persistence_psnr),
            Ok(predicted_ssim),
            Ok(persistence_ssim),
        ) = scores
        {
            self.psnr.add(predicted_psnr.min(PSNR_CAP_DB));
            self.persistence_psnr.add(persistence_psnr.min(PSNR_CAP_DB));
            self.ssim.add(predicted_ssim);
            self.persistence_ssim.add(persistence_ssim);
        }
    }

    pub(crate) fn figures(&self, step: u32, observations: u64) -> StepFigures {
        let persistence = self.latent_persistence_mse.get().filter(|mse| *mse > 0.0);
        StepFigures {
            step,
            predictions: self.predictions,
            missing: observations.saturating_sub(self.predictions),
            compared: self.psnr.count,
            psnr_db: self.psnr.get(),
            ssim: self.ssim.get(),
            persistence_psnr_db: self.persistence_psnr.get(),
            persistence_ssim: self.persistence_ssim.get(),
            latent_error_ratio: self
                .latent_mse
                .get()
                .zip(persistence)
                .map(|(mse, persistence)| mse / persistence),
            ready_latency: self.ready.percentiles(),
            received_latency: self.received.percentiles(),
        }
    }
}
