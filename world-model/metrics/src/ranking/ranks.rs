use crate::{
    MetricError,
    error::{finite, same_length},
};

/// Ranks of equal values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ties {
    /// The best of their ranks: 1, 2, 2, 4.
    Best,
    /// The mean of their ranks: 1, 2.5, 2.5, 4.
    Mean,
    /// The worst of their ranks: 1, 3, 3, 4.
    Worst,
    /// One rank, without gaps: 1, 2, 2, 3.
    Dense,
    /// In order of appearance: 1, 2, 3, 4.
    InOrder,
}

/// Rank of each value, 1 for the highest.
///
/// # Errors
/// [`MetricError::Empty`], [`MetricError::NotFinite`].
pub fn ranks(values: &[f64], ties: Ties) -> Result<Vec<f64>, MetricError> {
    if values.is_empty() {
        return Err(MetricError::Empty);
    }
    finite("values", values.iter().copied())?;
    let downwards: Vec<f64> = values.iter().map(|value| -value).collect();
    Ok(upwards(&downwards, ties))
}

/// Sum over raters of each model's rank by that rater; lowest is best. `raters` has the values of each rater, models in
/// the same order. The paper: "the sum of rank positions across both raters within each DiT-size group", without a rule
/// for ties.
///
/// # Errors
/// [`MetricError::Empty`] without a rater or a model; [`MetricError::Length`] if raters differ in the number of models;
/// [`MetricError::NotFinite`].
pub fn borda<R: AsRef<[f64]>>(raters: &[R], ties: Ties) -> Result<Vec<f64>, MetricError> {
    let (first, others) = raters.split_first().ok_or(MetricError::Empty)?;
    let mut sums = ranks(first.as_ref(), ties)?;
    for rater in others {
        same_length(sums.len(), rater.as_ref().len())?;
        let ranks = ranks(rater.as_ref(), ties)?;
        sums.iter_mut()
            .zip(ranks)
            .for_each(|(sum, rank)| *sum += rank);
    }
    Ok(sums)
}

/// Ranks from 1 for the lowest; equal values share their mean rank.
pub(crate) fn average_ranks(values: &[f64]) -> Vec<f64> {
    upwards(values, Ties::Mean)
}

fn upwards(values: &[f64], ties: Ties) -> Vec<f64> {
    let mut order: Vec<(usize, f64)> = values.iter().copied().enumerate().collect();
    // total_cmp orders -0 below 0; adding 0 makes them equal.
    order.sort_by(|a, b| (a.1 + 0.0).total_cmp(&(b.1 + 0.0)));
    let mut ranked = vec![0.0; values.len()];
    let mut before = 0;
    for (group, equals) in order.chunk_by(|a, b| a.1 == b.1).enumerate() {
        let (best, worst) = ((before + 1) as f64, (before + equals.len()) as f64);
        for (index, (place, _)) in equals.iter().enumerate() {
            let rank = match ties {
                Ties::Best => best,
                Ties::Mean => f64::midpoint(best, worst),
                Ties::Worst => worst,
                Ties::Dense => (group + 1) as f64,
                Ties::InOrder => best + index as f64,
            };
            if let Some(ranked) = ranked.get_mut(*place) {
                *ranked = rank;
            }
        }
        before += equals.len();
    }
    ranked
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn ranks_follow_the_tie_rule() {
        let values = [0.5, 0.9, 0.5, 0.1];
        let of = |ties| ranks(&values, ties).unwrap();
        assert_eq!(of(Ties::Best), [2.0, 1.0, 2.0, 4.0]);
        assert_eq!(of(Ties::Mean), [2.5, 1.0, 2.5, 4.0]);
        assert_eq!(of(Ties::Worst), [3.0, 1.0, 3.0, 4.0]);
        assert_eq!(of(Ties::Dense), [2.0, 1.0, 2.0, 3.0]);
        assert_eq!(of(Ties::InOrder), [2.0, 1.0, 3.0, 4.0]);
        assert_eq!(ranks(&[0.0, -0.0], Ties::Mean).unwrap(), [1.5, 1.5]);
    }

    #[test]
    fn borda_sums_over_raters() {
        let raters = [vec![0.1, 0.2, 0.3], vec![0.3, 0.2, 0.4]];
        assert_eq!(borda(&raters, Ties::Best).unwrap(), [5.0, 5.0, 2.0]);
        let none: [Vec<f64>; 0] = [];
        assert_eq!(borda(&none, Ties::Best), Err(MetricError::Empty));
        let ragged = borda(&[vec![0.1], vec![0.1, 0.2]], Ties::Best);
        assert!(matches!(ragged, Err(MetricError::Length { .. })));
        assert!(ranks(&[f64::NAN], Ties::Best).is_err());
    }
}
