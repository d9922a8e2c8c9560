use anyhow::Result;
use image::RgbImage;
use wm_metrics::MetricError;

use super::Values;

/// Pictures of a rollout, all of one size.
#[derive(Clone, Copy, Debug)]
pub struct RolloutPictures<'a> {
    /// Observed frames.
    pub observed: &'a [RgbImage],
    /// True frames, by step.
    pub truth: &'a [RgbImage],
    /// Predicted frames.
    pub predicted: &'a [RgbImage],
    /// Encoded and decoded true frames.
    pub reconstructed: &'a [RgbImage],
}

impl RolloutPictures<'_> {
    /// A figure of the predictions and of their ceiling.
    pub(super) fn both(&self, of: impl Fn(&[RgbImage]) -> Result<Vec<f64>>) -> Result<Values> {
        Ok(Values {
            predicted: of(self.predicted)?,
            reconstructed: of(self.reconstructed)?,
        })
    }

    /// One number for the predictions and one for their ceiling, or the reason for its absence.
    pub(super) fn one_each(
        &self,
        of: impl Fn(&[RgbImage]) -> Result<Result<f64, MetricError>>,
    ) -> Result<Result<Values, MetricError>> {
        let (predicted, reconstructed) = (of(self.predicted)?, of(self.reconstructed)?);
        Ok(predicted.and_then(|predicted| {
            Ok(Values {
                predicted: vec![predicted],
                reconstructed: vec![reconstructed?],
            })
        }))
    }
}
