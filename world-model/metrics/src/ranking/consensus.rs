use crate::{
    MetricError,
    error::{finite, same_length},
};

/// Least score that counts as success (the paper, appendix C.1 B).
pub const SUCCESS_THRESHOLD: f64 = 0.5;

/// Whether every rater counts a trial as success, by trial. `raters` has the scores of each rater, trials in the same
/// order.
///
/// # Errors
/// [`MetricError::Empty`] without a rater or a trial; [`MetricError::Length`] if raters differ in the number of trials;
/// [`MetricError::NotFinite`].
pub fn consensus<R: AsRef<[f64]>>(raters: &[R], threshold: f64) -> Result<Vec<bool>, MetricError> {
    let trials = raters.first().ok_or(MetricError::Empty)?.as_ref().len();
    let mut agreed = vec![true; trials];
    for rater in raters {
        let scores = rater.as_ref();
        same_length(trials, scores.len())?;
        finite("scores", scores.iter().copied())?;
        agreed
            .iter_mut()
            .zip(scores)
            .for_each(|(agreed, score)| *agreed &= *score >= threshold);
    }
    Ok(agreed)
}

/// The paper's "consensus SR": share of the trials that every rater scores at [`SUCCESS_THRESHOLD`] or above.
///
/// # Errors
/// Those of [`consensus`].
pub fn consensus_rate<R: AsRef<[f64]>>(raters: &[R]) -> Result<f64, MetricError> {
    let agreed = consensus(raters, SUCCESS_THRESHOLD)?;
    let successes = agreed.iter().filter(|agreed| **agreed).count();
    Ok(successes as f64 / agreed.len() as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn all_raters_must_agree() {
        let raters = [[0.5, 0.9, 0.4, 1.0], [0.5, 0.2, 0.9, 0.7]];
        assert_eq!(consensus(&raters, 0.5).unwrap(), [true, false, false, true]);
        assert_eq!(consensus_rate(&raters), Ok(0.5));
        assert_eq!(consensus_rate::<Vec<f64>>(&[]), Err(MetricError::Empty));
        assert_eq!(consensus_rate(&[Vec::new()]), Err(MetricError::Empty));
        let nan = consensus_rate(&[[f64::NAN]]);
        assert!(matches!(nan, Err(MetricError::NotFinite { .. })));
    }
}
