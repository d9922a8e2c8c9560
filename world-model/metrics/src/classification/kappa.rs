use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{
    MetricError,
    error::{at_least, same_length},
};

/// Cohen's kappa of two raters' labels of any number of classes: 1 for full agreement, 0 for agreement by chance. Same
/// as scikit-learn's unweighted `cohen_kappa_score`; the paper chooses its VLM raters by it (appendices A and C.5).
///
/// # Errors
/// [`MetricError::Length`], [`MetricError::Empty`]; [`MetricError::Constant`] if both raters give the same single label
/// to all.
pub fn cohen_kappa<L: Ord>(first: &[L], second: &[L]) -> Result<f64, MetricError> {
    same_length(first.len(), second.len())?;
    let mut labels: BTreeMap<&L, [u64; 2]> = BTreeMap::new();
    for (side, ratings) in [first, second].into_iter().enumerate() {
        for label in ratings {
            if let Some(count) = labels.entry(label).or_default().get_mut(side) {
                *count += 1;
            }
        }
    }
    if labels.len() == 1 {
        return Err(MetricError::Constant {
            what: "the labels of both raters",
        });
    }
    let all = first.len() as f64;
    let agreed = first.iter().zip(second).filter(|(a, b)| a == b).count() as f64 / all;
    let chance = labels.values().map(|[a, b]| *a as f64 * *b as f64);
    let chance = chance.sum::<f64>() / (all * all);
    Ok((agreed - chance) / (1.0 - chance))
}

/// Two raters and their agreement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Index of the first rater, from 0.
    pub first: usize,
    /// Index of the second rater, above the first.
    pub second: usize,
    /// Cohen's kappa.
    pub kappa: f64,
}

/// The two raters with the highest [`cohen_kappa`]; of equal pairs, the first. The paper chose two of three VLMs so.
/// Pairs without a kappa are skipped.
///
/// # Errors
/// [`MetricError::TooFew`] below two raters; [`MetricError::Length`], [`MetricError::Empty`]; [`MetricError::Constant`]
/// if no pair has a kappa.
pub fn closest_raters<L: Ord, R: AsRef<[L]>>(raters: &[R]) -> Result<Agreement, MetricError> {
    at_least("raters", 2, raters.len())?;
    let mut best: Option<Agreement> = None;
    for (first, a) in raters.iter().enumerate() {
        for (second, b) in raters.iter().enumerate().skip(first + 1) {
            let kappa = match cohen_kappa(a.as_ref(), b.as_ref()) {
                Err(MetricError::Constant { .. }) => continue,
                kappa => kappa?,
            };
            if best.is_none_or(|best| kappa > best.kappa) {
                best = Some(Agreement {
                    first,
                    second,
                    kappa,
                });
            }
        }
    }
    best.ok_or(MetricError::Constant {
        what: "the labels of all raters",
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn kappa_matches_the_textbook() {
        // 20 both yes, 15 both no, 5 and 10 differ: 0.7 agreement, 0.5 by chance.
        let cells = [
            (true, true, 20),
            (true, false, 5),
            (false, true, 10),
            (false, false, 15),
        ];
        let pairs = cells
            .iter()
            .flat_map(|(a, b, count)| vec![(*a, *b); *count]);
        let (a, b): (Vec<bool>, Vec<bool>) = pairs.unzip();
        assert!((cohen_kappa(&a, &b).unwrap() - 0.4).abs() < 1e-12);
    }

    #[test]
    fn closest_two_of_three_raters_are_found() {
        let raters = [
            vec![1, 0, 1, 0, 1],
            vec![1, 0, 0, 0, 1],
            vec![1, 1, 0, 0, 1],
        ];
        let found = closest_raters(&raters).unwrap();
        assert_eq!((found.first, found.second), (0, 1));
        let still = [[1, 1], [1, 1]];
        assert!(matches!(
            closest_raters(&still),
            Err(MetricError::Constant { .. })
        ));
        assert!(matches!(
            closest_raters(&still[..1]),
            Err(MetricError::TooFew { .. })
        ));
    }

    proptest! {
        #[test]
        fn kappa_is_symmetric_and_ignores_names(pairs in prop::collection::vec((0_u8..4, 0_u8..4), 1..50)) {
            let (a, b): (Vec<u8>, Vec<u8>) = pairs.into_iter().unzip();
            let kappa = cohen_kappa(&a, &b);
            prop_assert_eq!(&kappa, &cohen_kappa(&b, &a));
            let renamed = |labels: &[u8]| -> Vec<u8> { labels.iter().map(|label| 9 - label).collect() };
            if let (Ok(kappa), Ok(other)) = (&kappa, &cohen_kappa(&renamed(&a), &renamed(&b))) {
                prop_assert!((kappa - other).abs() < 1e-12);
                prop_assert!(*kappa <= 1.0);
            }
        }
    }
}
