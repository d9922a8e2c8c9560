//! Error of depth that is known up to its scale, as a monocular network gives it.
//!
//! Both figures are AbsRel, the mean of |d - d*| / d* over the pixels whose true depth is above [`LEAST_DEPTH`]; they
//! differ in how the prediction is aligned before, and do not stand for each other. Pass the maps of one video one after
//! another to align them together, as WorldArena does, or each frame alone.

use crate::{
    MetricError,
    error::{finite, mean, same_length},
};

/// True depth up to which a pixel is left out \[unit of the depth\], as WorldArena.
pub const LEAST_DEPTH: f64 = 1e-3;

/// What WorldArena adds to the true depth before it divides.
const GUARD: f64 = 1e-6;

/// AbsRel after the prediction is scaled to the median of the truth, both over all pixels, of an even number the lower of
/// the middle two (PyTorch's `median`). The paper's "Depth AbsRel", which WorldArena computes so
/// (`video_quality/WorldArena/depth_accuracy.py`).
///
/// # Errors
/// [`MetricError::Length`]; [`MetricError::Empty`] where no pixel counts; [`MetricError::NotFinite`];
/// [`MetricError::Range`] where the predicted median is not above 0.
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

/// AbsRel after the prediction has the scale and the shift that bring it closest to the truth in the mean square, over
/// the pixels that count.
///
/// # Errors
/// [`MetricError::Length`]; [`MetricError::Empty`] where no pixel counts; [`MetricError::NotFinite`];
/// [`MetricError::Constant`] where the prediction never varies.
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
    // Counts stay far below 2^52.
    Ok(sum / count as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_scaled_truth_has_no_error() {
        let truth = [1.0, 2.0, 4.0, 8.0];
        let scaled = truth.map(|depth| depth * 3.0);
        assert!(abs_rel_median_scaled(&scaled, &truth).unwrap() < 1e-12);
        let shifted = truth.map(|depth| depth * 0.5 + 2.0);
        assert!(abs_rel_scaled_and_shifted(&shifted, &truth).unwrap() < 1e-12);
        assert!(abs_rel_median_scaled(&shifted, &truth).unwrap() > 0.1);
    }

    #[test]
    fn medians_are_the_lower_ones() {
        // Medians 2 and 1: scaled, 1 2 and 3 stand against 1 1 and 5; the pixel without depth is left out.
        let found = abs_rel_median_scaled(&[2.0, 0.0, 4.0, 6.0], &[1.0, 0.0, 1.0, 5.0]).unwrap();
        assert!((found - (0.0 + 1.0 + 0.4) / 3.0).abs() < 1e-5, "{found}");
    }

    #[test]
    fn what_has_no_error_is_named() {
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
