use std::fmt;

use serde::{Deserialize, Serialize};
use wm_metrics::classification::{Confusion, roc_auc};

use crate::Figure;

/// Accuracy of a success probe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Episodes under their own instruction.
    pub episodes: usize,
    /// Recall of successes and of failures at a probability of one half; NaN for an empty class.
    pub recalls: [f64; 2],
    /// Area under the ROC curve: the probability that a success scores above a failure.
    pub auc: f64,
    /// Share of the successes rejected under another episode's instruction; `None` if not measured.
    pub mismatches: Option<f64>,
}

impl Accuracy {
    /// From logits under an episode's own instruction with the truth, and logits under another's.
    #[must_use]
    pub fn of(own: &[(f32, bool)], mismatched: &[f32]) -> Self {
        let (scores, truth): (Vec<f64>, Vec<bool>) = own
            .iter()
            .map(|(logit, truth)| (f64::from(*logit), *truth))
            .unzip();
        let verdicts: Vec<bool> = scores.iter().map(|logit| *logit > 0.0).collect();
        let recalls = Confusion::of(&verdicts, &truth).map(|found| {
            [found.recall_of_positives(), found.recall_of_negatives()]
                .map(|recall| recall.unwrap_or(f64::NAN))
        });
        let refused = mismatched.iter().filter(|logit| **logit <= 0.0).count();
        Self {
            episodes: own.len(),
            recalls: recalls.unwrap_or([f64::NAN; 2]),
            auc: roc_auc(&scores, &truth).unwrap_or(f64::NAN),
            mismatches: (!mismatched.is_empty()).then(|| refused as f64 / mismatched.len() as f64),
        }
    }

    /// Balanced accuracy: the mean recall of both classes; NaN if one is empty.
    #[must_use]
    pub fn balanced(&self) -> f64 {
        let [of_successes, of_failures] = self.recalls;
        f64::midpoint(of_successes, of_failures)
    }

    /// Figures of a validation.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        let mut figures = vec![
            Figure::new("balanced_accuracy", self.balanced()),
            Figure::new("auc", self.auc),
        ];
        let mismatches = self.mismatches.into_iter();
        figures.extend(mismatches.map(|share| Figure::new("mismatches_refused", share)));
        figures
    }

    /// Whether it is better: by balanced accuracy, then by AUC (the paper, appendix B.7). Without both classes, the
    /// later one wins.
    #[must_use]
    pub fn is_better_than(&self, other: &Self) -> bool {
        let balanced = self.balanced();
        if balanced.is_nan() {
            return true;
        }
        let order = balanced.total_cmp(&other.balanced());
        order.then(self.auc.total_cmp(&other.auc)).is_gt()
    }
}

impl fmt::Display for Accuracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (balanced, [of_successes, of_failures]) = (self.balanced(), self.recalls);
        write!(
            f,
            "{} episodes: balanced accuracy {balanced:.3} (of successes {of_successes:.3}, of failures {of_failures:.3}), \
             AUC {:.3}",
            self.episodes, self.auc
        )?;
        match self.mismatches {
            Some(share) => write!(f, ", {share:.3} of other instructions refused"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_have_equal_weight_and_ranks_give_the_auc() {
        let own = [
            (2.0, true),
            (-1.0, true),
            (-2.0, false),
            (-0.5, false),
            (-3.0, false),
        ];
        let found = Accuracy::of(&own, &[-1.0, 1.0]);
        assert_eq!(found.episodes, 5);
        assert_eq!(found.recalls, [0.5, 1.0]);
        assert!((found.balanced() - 0.75).abs() < 1e-12, "{found}");
        // Only one pair of six, (-1, -0.5), is in the wrong order.
        assert!((found.auc - 5.0 / 6.0).abs() < 1e-12, "{found}");
        assert_eq!(found.mismatches, Some(0.5));
        let better = Accuracy { auc: 0.9, ..found };
        assert!(better.is_better_than(&found) && !found.is_better_than(&better));
    }
}
