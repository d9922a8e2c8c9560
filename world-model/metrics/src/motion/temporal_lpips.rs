use crate::{
    MetricError,
    error::{finite, same_length},
};

/// The paper's t-LPIPS (appendix C.2 B): mean absolute difference between the LPIPS of each step of the generated and
/// of the true video.
///
/// `generated` and `truth` have one LPIPS per step, between a frame and its successor [warped](super::warp()) by the
/// optical flow of the *true* frames, for both videos. The paper does not specify which frame is warped; the flow from
/// t - 1 to t warps frame t onto t - 1.
///
/// # Errors
/// [`MetricError::Length`], [`MetricError::Empty`], [`MetricError::NotFinite`].
pub fn temporal_lpips(generated: &[f64], truth: &[f64]) -> Result<f64, MetricError> {
    same_length(generated.len(), truth.len())?;
    finite("distances", generated.iter().chain(truth).copied())?;
    let differences = generated.iter().zip(truth).map(|(a, b)| (a - b).abs());
    Ok(differences.sum::<f64>() / generated.len() as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn differences_are_taken_per_step() {
        let found = temporal_lpips(&[0.1, 0.3], &[0.2, 0.2]).unwrap();
        assert!((found - 0.1).abs() < 1e-12);
        assert_eq!(temporal_lpips(&[], &[]), Err(MetricError::Empty));
        assert!(matches!(
            temporal_lpips(&[0.1], &[]),
            Err(MetricError::Length { .. })
        ));
        assert!(temporal_lpips(&[f64::NAN], &[0.0]).is_err());
    }
}
