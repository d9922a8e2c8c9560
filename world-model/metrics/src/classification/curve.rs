use crate::{
    MetricError,
    error::{finite, same_length},
    ranking::average_ranks,
};

/// Area under the ROC curve: the probability that a positive's score exceeds a negative's; equal scores count half.
/// Same as scikit-learn's `roc_auc_score`; scores may be logits or probabilities.
///
/// # Errors
/// [`MetricError::Length`], [`MetricError::Empty`], [`MetricError::NotFinite`]; [`MetricError::Constant`] if there is
/// only one class.
pub fn roc_auc(scores: &[f64], truth: &[bool]) -> Result<f64, MetricError> {
    same_length(scores.len(), truth.len())?;
    finite("scores", scores.iter().copied())?;
    let positives = truth.iter().filter(|truth| **truth).count();
    if positives == 0 || positives == truth.len() {
        return Err(MetricError::Constant { what: "the truth" });
    }
    let (positives, all) = (positives as f64, truth.len() as f64);
    let ranks = average_ranks(scores);
    let of_positives = ranks.iter().zip(truth).filter(|(_, truth)| **truth);
    let sum: f64 = of_positives.map(|(rank, _)| rank).sum();
    Ok((sum - positives * (positives + 1.0) / 2.0) / (positives * (all - positives)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn auc_counts_wrong_and_equal_pairs() {
        let scores = [2.0, -1.0, -2.0, -0.5, -1.0];
        let truth = [true, true, false, false, false];
        let expected = (6.0 - 1.0 - 0.5) / 6.0;
        assert!((roc_auc(&scores, &truth).unwrap() - expected).abs() < 1e-12);
        assert!(matches!(
            roc_auc(&[1.0], &[true]),
            Err(MetricError::Constant { .. })
        ));
    }

    proptest! {
        #[test]
        fn auc_is_the_share_of_ordered_pairs(samples in prop::collection::vec((-5_i8..5, any::<bool>()), 2..40)) {
            let (scores, truth): (Vec<f64>, Vec<bool>) = samples.iter().map(|(s, t)| (f64::from(*s), *t)).unzip();
            let (mut wins, mut pairs) = (0.0, 0.0);
            for (a, _) in samples.iter().filter(|(_, truth)| *truth) {
                for (b, _) in samples.iter().filter(|(_, truth)| !*truth) {
                    pairs += 1.0;
                    wins += match a.cmp(b) {
                        std::cmp::Ordering::Greater => 1.0,
                        std::cmp::Ordering::Equal => 0.5,
                        std::cmp::Ordering::Less => 0.0,
                    };
                }
            }
            match roc_auc(&scores, &truth) {
                Ok(area) => prop_assert!((area - wins / pairs).abs() < 1e-12),
                Err(_) => prop_assert_eq!(pairs, 0.0),
            }
        }
    }
}
