use crate::onnx::Depth;
use anyhow::Result;
use image::RgbImage;
use wm_metrics::{MetricError, depth::abs_rel_median_scaled};

use super::{RolloutPictures, Values};

/// The frames of a video are scaled together, as WorldArena does.
pub(super) fn measure(
    network: &Depth,
    pictures: &RolloutPictures<'_>,
) -> Result<Result<Values, MetricError>> {
    let maps = |video: &[RgbImage]| -> Result<Vec<f32>> {
        let mut depths = Vec::new();
        for picture in video {
            depths.extend(network.of(picture)?.values);
        }
        Ok(depths)
    };
    let truth = maps(pictures.truth)?;
    pictures.one_each(|video| Ok(abs_rel_median_scaled(&maps(video)?, &truth)))
}
