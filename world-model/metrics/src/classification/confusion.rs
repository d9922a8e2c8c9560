use serde::{Deserialize, Serialize};

use crate::{MetricError, error::same_length};

/// Confusion matrix of binary verdicts; positive means success.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confusion {
    /// Positives with a positive verdict.
    pub true_positives: usize,
    /// Positives with a negative verdict.
    pub false_negatives: usize,
    /// Negatives with a negative verdict.
    pub true_negatives: usize,
    /// Negatives with a positive verdict.
    pub false_positives: usize,
}

impl Confusion {
    /// Counts verdicts against truths, one by one.
    ///
    /// # Errors
    /// [`MetricError::Length`], [`MetricError::Empty`].
    pub fn of(verdicts: &[bool], truth: &[bool]) -> Result<Self, MetricError> {
        same_length(verdicts.len(), truth.len())?;
        let mut counts = Self::default();
        for pair in verdicts.iter().zip(truth) {
            let count = match pair {
                (true, true) => &mut counts.true_positives,
                (false, true) => &mut counts.false_negatives,
                (false, false) => &mut counts.true_negatives,
                (true, false) => &mut counts.false_positives,
            };
            *count += 1;
        }
        Ok(counts)
    }

    /// Share of the positives that are found; `None` without positives.
    #[must_use]
    pub fn recall_of_positives(&self) -> Option<f64> {
        share(self.true_positives, self.false_negatives)
    }

    /// Share of the negatives that are found; `None` without negatives.
    #[must_use]
    pub fn recall_of_negatives(&self) -> Option<f64> {
        share(self.true_negatives, self.false_positives)
    }

    /// Mean of both recalls; `None` if a class is empty. The paper's "balanced accuracy" of the success probe (appendix
    /// C.3 B), and scikit-learn's `balanced_accuracy_score`.
    #[must_use]
    pub fn balanced_accuracy(&self) -> Option<f64> {
        let recalls = self.recall_of_positives().zip(self.recall_of_negatives());
        recalls.map(|(positives, negatives)| f64::midpoint(positives, negatives))
    }

    /// Share of correct verdicts; `None` if empty.
    #[must_use]
    pub fn accuracy(&self) -> Option<f64> {
        let right = self.true_positives + self.true_negatives;
        share(right, self.false_positives + self.false_negatives)
    }
}

fn share(right: usize, wrong: usize) -> Option<f64> {
    let all = right + wrong;
    (all > 0).then(|| right as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn classes_count_alike() {
        let truth = [true, true, false, false, false, false];
        let verdicts = [true, false, false, false, false, true];
        let counts = Confusion::of(&verdicts, &truth).unwrap();
        assert_eq!(counts.recall_of_positives(), Some(0.5));
        assert_eq!(counts.recall_of_negatives(), Some(0.75));
        assert_eq!(counts.balanced_accuracy(), Some(0.625));
        assert_eq!(counts.accuracy(), Some(4.0 / 6.0));
    }

    #[test]
    fn one_class_has_no_balanced_accuracy() {
        let counts = Confusion::of(&[true, false], &[true, true]).unwrap();
        assert_eq!(counts.balanced_accuracy(), None);
        assert_eq!(counts.recall_of_positives(), Some(0.5));
        assert_eq!(Confusion::of(&[], &[]), Err(MetricError::Empty));
    }
}
