use super::Flow;
use crate::{MetricError, error::at_least, images::psnr::same_size};

/// Margin that WorldScore and WorldArena skip, both sides together, because flow leaves the picture there \[px\].
pub const PHOTOMETRIC_CROP_PX: u32 = 30;

/// Average end-point error of a pair \[px\]: the distance of a pixel to itself after the forward flow and then the
/// backward flow at the nearest pixel. A total margin of `crop_px` per axis is skipped; a pixel that lands outside uses
/// the flow at the edge. Same as `compute_epe` of WorldScore and WorldArena
/// (`video_quality/WorldArena/flow_aepe_metrics.py`).
///
/// # Errors
/// [`MetricError::Size`]; [`MetricError::TooSmall`] if the crop leaves no pixel.
pub fn forward_backward_error(
    forward: &Flow,
    backward: &Flow,
    crop_px: u32,
) -> Result<f64, MetricError> {
    same_size(forward.dimensions(), backward.dimensions())?;
    let (width, height) = forward.dimensions();
    if width <= crop_px || height <= crop_px {
        return Err(MetricError::TooSmall {
            size: (width, height),
            window: crop_px + 1,
        });
    }
    let (width, height) = (width - crop_px, height - crop_px);
    let start = (crop_px / 2) as usize;
    let mut sum = 0.0;
    for y in 0..height {
        for x in 0..width {
            let at = |flow: &Flow, x: u32, y: u32| {
                // Inside both flows for every cropped position.
                let vector = flow.at(x as usize + start, y as usize + start);
                vector.unwrap_or((0.0, 0.0))
            };
            let (u, v) = at(forward, x, y);
            let (column, row) = (
                nearest(f64::from(x) + u, width),
                nearest(f64::from(y) + v, height),
            );
            let (back_u, back_v) = at(backward, column, row);
            sum += (u + back_u).hypot(v + back_v);
        }
    }
    Ok(sum / (f64::from(width) * f64::from(height)))
}

/// Mean over a clip's pairs (forward, backward) of [`forward_backward_error`] at [`PHOTOMETRIC_CROP_PX`] \[px\]; lower
/// is better, as in WorldScore before normalisation. WorldArena reports the inverse, times the [soft dynamic
/// degree](super::soft_dynamic_degree) if that is up to 0.1213. The paper prints values from 71 to 104 as "lower is
/// better", without unit or scale, far from both.
///
/// # Errors
/// [`MetricError::TooFew`] without a pair; those of [`forward_backward_error`].
pub fn photometric_consistency(pairs: &[(Flow, Flow)]) -> Result<f64, MetricError> {
    at_least("pairs of frames", 1, pairs.len())?;
    let errors = pairs
        .iter()
        .map(|(forward, backward)| forward_backward_error(forward, backward, PHOTOMETRIC_CROP_PX));
    Ok(errors.sum::<Result<f64, _>>()? / pairs.len() as f64)
}

/// The nearest pixel; halves round to even, as NumPy's `round`.
fn nearest(place: f64, side: u32) -> u32 {
    // An integer from 0 to the last pixel.
    place.round_ties_even().clamp(0.0, f64::from(side - 1)) as u32
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn flow(u: f32, v: f32) -> Flow {
        Flow::new(40, 36, vec![u; 1440], vec![v; 1440]).unwrap()
    }

    #[test]
    fn inverse_flows_have_no_error() {
        assert_eq!(
            photometric_consistency(&[(flow(2.0, -1.0), flow(-2.0, 1.0))]),
            Ok(0.0)
        );
        let pairs = [
            (flow(2.0, 4.0), flow(1.0, 0.0)),
            (flow(0.0, 0.0), flow(0.0, 0.0)),
        ];
        assert!((photometric_consistency(&pairs).unwrap() - 2.5).abs() < 1e-9);
    }

    #[test]
    fn backward_flow_is_read_at_the_target_pixel() {
        let forward = Flow::new(2, 1, vec![1.0, 0.0], vec![0.0; 2]).unwrap();
        let backward = Flow::new(2, 1, vec![5.0, -1.0], vec![0.0; 2]).unwrap();
        // Both land at 1: 0 and 1 px off.
        assert_eq!(forward_backward_error(&forward, &backward, 0), Ok(0.5));
    }

    #[test]
    fn undefined_errors_are_named() {
        let small = Flow::new(30, 40, vec![0.0; 1200], vec![0.0; 1200]).unwrap();
        let error = photometric_consistency(&[(small.clone(), small)]).unwrap_err();
        assert!(matches!(error, MetricError::TooSmall { window: 31, .. }));
        assert!(matches!(
            photometric_consistency(&[]),
            Err(MetricError::TooFew { .. })
        ));
    }
}
