use crate::onnx::Flow as FlowNetwork;
use anyhow::Result;
use image::{DynamicImage, RgbImage};
use wm_metrics::{
    MetricError,
    motion::{Flow, temporal_lpips, warp},
};

use super::{RolloutPictures, Values, learned_distance::LearnedDistance, motion::between};

/// t-LPIPS: each frame except the first is warped back onto its predecessor by the true flow.
pub(super) fn measure(
    lpips: &LearnedDistance,
    network: &FlowNetwork,
    pictures: &RolloutPictures<'_>,
) -> Result<Result<Values, MetricError>> {
    let truth = pictures.truth;
    let pairs = truth.iter().zip(truth.iter().skip(1));
    let flows = pairs.map(|(first, second)| between(network, first, second));
    let flows: Vec<Flow> = flows.collect::<Result<_>>()?;
    let steps = |video: &[RgbImage]| -> Result<Vec<f64>> {
        let followers = video.iter().skip(1).zip(&flows);
        let warped: Vec<RgbImage> = followers
            .map(|(picture, flow)| {
                let picture = DynamicImage::from(picture.clone()).into_rgb32f();
                // Rounded to 8 bits for the network.
                Ok(DynamicImage::from(warp(&picture, flow)?).into_rgb8())
            })
            .collect::<Result<_>>()?;
        lpips.between(video.iter().zip(&warped))
    };
    let of_truth = steps(truth)?;
    pictures.one_each(|video| Ok(temporal_lpips(&steps(video)?, &of_truth)))
}
