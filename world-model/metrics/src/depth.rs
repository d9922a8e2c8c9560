//! Error of depth of unknown scale, as monocular networks give it.
//!
//! Both metrics are AbsRel, the mean of |d - d*| / d* over pixels with a true depth above [`LEAST_DEPTH`]. They align
//! the prediction differently and are not interchangeable. Concatenate the maps of a video to align them together, as
//! WorldArena does, or pass each frame alone.

use crate::{
    MetricError,
    error::{finite, mean, same_length},
};

/// Pixels up to this true depth are skipped \[unit of the depth\], as in WorldArena.
pub const LEAST_DEPTH: f64 = 1e-3;

/// WorldArena adds this to the true depth in the division.
const GUARD: f64 = 1e-6;

/// AbsRel after scaling the prediction to the true median over all pixels; an even count takes the lower middle value
/// (PyTorch's `median`). The paper's "Depth AbsRel", as computed by WorldArena
/// (`video_quality/WorldArena/depth_accuracy.py`).
///
/// # Errors
/// [`MetricError::Length`]; [`MetricError::Empty`] if no pixel counts; [`MetricError::NotFinite`];
/// [`MetricError::Range`] unless the predicted median is above 0.
pub fn abs_rel_median_scaled(predicted: &[f32], truth: &[f32]) -> Result<f64, MetricError> {
    let (predicted, truth) = maps(predicted, truth)?;
    let (own, others) = (lower_median(&predicted), lower_median(&truth));
    if own <= 0.0 {
        return Err(MetricError::Range {
            what: "the median of the predicted depth",
            expected: "above 0",
            actual: own.to_string(),
        });
    }
    abs_rel(predicted.iter().map(|depth| depth * others / own), &truth)
}

/// AbsRel after the least-squares scale and shift of the prediction, over the counted pixels.
///
/// # Errors
/// [`MetricError::Length`]; [`MetricError::Empty`] if no pixel counts; [`MetricError::NotFinite`];
/// [`MetricError::Constant`] if the prediction is constant.
pub fn abs_rel_scaled_and_shifted(predicted: &[f32], truth: &[f32]) -> Result<f64, MetricError> {
    let (predicted, truth) = maps(predicted, truth)?;
    let pairs = predicted
        .iter()
        .zip(&truth)
        .filter(|(_, truth)| **truth > LEAST_DEPTH);
    let (own, others): (Vec<f64>, Vec<f64>) = pairs.unzip();
    if own.is_empty() {
        return Err(MetricError::Empty);
    }
    crate::error::varying("the predicted depth", &own)?;
    let (mean_own, mean_others) = (mean(&own), mean(&others));
    let (mut variance, mut covariance) = (0.0, 0.0);
    for (own, other) in own.iter().zip(&others) {
        variance += (own - mean_own).powi(2);
        covariance += (own - mean_own) * (other - mean_others);
    }
    let scale = covariance / variance;
    abs_rel(
        own.iter()
            .map(|depth| mean_others + scale * (depth - mean_own)),
        &others,
    )
}

fn maps(predicted: &[f32], truth: &[f32]) -> Result<(Vec<f64>, Vec<f64>), MetricError> {
    same_length(predicted.len(), truth.len())?;
    let widened = |depth: &[f32]| depth.iter().copied().map(f64::from).collect::<Vec<_>>();
    let (predicted, truth) = (widened(predicted), widened(truth));
    finite("predicted depths", predicted.iter().copied())?;
    finite("true depths", truth.iter().copied())?;
    Ok((predicted, truth))
}

fn lower_median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    let middle = (values.len().max(1) - 1) / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn abs_rel(predicted: impl Iterator<Item = f64>, truth: &[f64]) -> Result<f64, MetricError> {
    let (mut sum, mut count) = (0.0, 0_u64);
    for (predicted, truth) in predicted
        .zip(truth)
        .filter(|(_, truth)| **truth > LEAST_DEPTH)
    {
        sum += (predicted - truth).abs() / (truth + GUARD);
        count += 1;
    }
    if count == 0 {
        return Err(MetricError::Empty);
    }
    Ok(sum / count as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn scaled_truth_has_no_error() {
        let truth = [1.0, 2.0, 4.0, 8.0];
        let scaled = truth.map(|depth| depth * 3.0);
        assert!(abs_rel_median_scaled(&scaled, &truth).unwrap() < 1e-12);
        let shifted = truth.map(|depth| depth * 0.5 + 2.0);
        assert!(abs_rel_scaled_and_shifted(&shifted, &truth).unwrap() < 1e-12);
        assert!(abs_rel_median_scaled(&shifted, &truth).unwrap() > 0.1);
    }

    #[test]
    fn median_of_even_count_is_the_lower() {
        // Medians 2 and 1: scaled, 1 2 and 3 compare with 1 1 and 5; the pixel without depth is skipped.
        let found = abs_rel_median_scaled(&[2.0, 0.0, 4.0, 6.0], &[1.0, 0.0, 1.0, 5.0]).unwrap();
        assert!((found - (0.0 + 1.0 + 0.4) / 3.0).abs() < 1e-5, "{found}");
    }

    #[test]
    fn undefined_errors_are_named() {
        assert_eq!(
            abs_rel_median_scaled(&[1.0], &[0.0]),
            Err(MetricError::Empty)
        );
        assert_eq!(
            abs_rel_scaled_and_shifted(&[1.0], &[0.0]),
            Err(MetricError::Empty)
        );
        let behind = abs_rel_median_scaled(&[-1.0], &[1.0]);
        assert!(matches!(behind, Err(MetricError::Range { .. })));
        let flat = abs_rel_scaled_and_shifted(&[1.0, 1.0], &[1.0, 2.0]);
        assert!(matches!(flat, Err(MetricError::Constant { .. })));
        assert!(abs_rel_median_scaled(&[f32::NAN], &[1.0]).is_err());
    }
}
