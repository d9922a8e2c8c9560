use crate::onnx::Flow as FlowNetwork;
use anyhow::Result;
use image::RgbImage;
use wm_metrics::{
    MetricError,
    motion::{
        DYNAMIC_THRESHOLD_PX, Flow, PHOTOMETRIC_CROP_PX, dynamic_degree, flow_score,
        forward_backward_error, mean_flow, soft_dynamic_degree,
    },
};

use super::{EpisodeFigure, EpisodePerception, Values};

/// Motion between consecutive predicted frames.
pub(super) fn measure(
    network: &FlowNetwork,
    predicted: &[RgbImage],
    found: &mut EpisodePerception,
) -> Result<()> {
    let (mut flows, mut errors) = (Vec::new(), Vec::new());
    for (first, second) in predicted.iter().zip(predicted.iter().skip(1)) {
        let flow = between(network, first, second)?;
        let back = between(network, second, first)?;
        errors.push(forward_backward_error(&flow, &back, PHOTOMETRIC_CROP_PX));
        flows.push(flow);
    }
    let errors: Result<Vec<f64>, MetricError> = errors.into_iter().collect();
    let one = |value: Result<f64, MetricError>| value.map(|value| vec![value]);
    for (figure, values) in [
        (
            EpisodeFigure::DynamicDegree,
            one(dynamic_degree(&flows, DYNAMIC_THRESHOLD_PX)),
        ),
        (
            EpisodeFigure::DynamicDegreeSoft,
            one(soft_dynamic_degree(&flows)),
        ),
        (EpisodeFigure::FlowScore, one(flow_score(&flows))),
        (EpisodeFigure::FlowMean, one(mean_flow(&flows))),
        (EpisodeFigure::PhotometricConsistency, errors),
    ] {
        if flows.is_empty() {
            found.lack(
                figure.name(),
                "one predicted frame, but motion needs two".into(),
            );
        } else {
            found.keep(figure, values.map(Values::of));
        }
    }
    Ok(())
}

/// The flow from one picture to another.
pub(super) fn between(network: &FlowNetwork, first: &RgbImage, second: &RgbImage) -> Result<Flow> {
    let field = network.between(first, second)?;
    Ok(Flow::new(first.width(), first.height(), field.u, field.v)?)
}
