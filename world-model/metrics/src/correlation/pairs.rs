use serde::{Deserialize, Serialize};

use crate::{
    MetricError,
    error::{at_least, finite, mean, same_length, varying},
    ranking::average_ranks,
    statistics::{Interval, Z95},
};

/// A correlation of pairs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// In \[-1, 1\].
    pub r: f64,
    /// Number of pairs.
    pub pairs: usize,
    /// 95 % interval by Fisher's z; `None` below four pairs. It assumes independent pairs; the steps of one episode are
    /// not.
    pub interval: Option<Interval>,
}

/// Pearson's r, with the value and interval of SciPy's `pearsonr`.
///
/// # Errors
/// [`MetricError::Length`], [`MetricError::Empty`]; [`MetricError::TooFew`] below two pairs;
/// [`MetricError::NotFinite`]; [`MetricError::Constant`] if one side is constant.
pub fn pearson(x: &[f64], y: &[f64]) -> Result<Correlation, MetricError> {
    let r = coefficient(x, y)?;
    Ok(Correlation {
        r,
        pairs: x.len(),
        interval: fisher(r, x.len(), 1.0),
    })
}

/// Spearman's rho, as SciPy's `spearmanr`: Pearson's r of the ranks, where equal values share their mean rank. The
/// variance of Fisher's z is (1 + rho^2 / 2) / (n - 3), after Bonett and Wright 2000.
///
/// # Errors
/// Those of [`pearson`].
pub fn spearman(x: &[f64], y: &[f64]) -> Result<Correlation, MetricError> {
    finite("values", x.iter().chain(y).copied())?;
    let r = coefficient(&average_ranks(x), &average_ranks(y))?;
    Ok(Correlation {
        r,
        pairs: x.len(),
        interval: fisher(r, x.len(), 1.0 + r * r / 2.0),
    })
}

fn coefficient(x: &[f64], y: &[f64]) -> Result<f64, MetricError> {
    same_length(x.len(), y.len())?;
    at_least("pairs", 2, x.len())?;
    for side in [x, y] {
        finite("values", side.iter().copied())?;
        varying("values", side)?;
    }
    let (x, y) = (unit(x), unit(y));
    let products = x.iter().zip(&y).map(|(x, y)| x * y);
    let r = products.sum::<f64>();
    finite("squares of the values", [r])?;
    Ok(r.clamp(-1.0, 1.0))
}

/// Differences to the mean, scaled to a sum of squares of 1. They are divided by the largest first, so that squares
/// neither vanish nor overflow.
fn unit(values: &[f64]) -> Vec<f64> {
    let mean = mean(values);
    let mut differences: Vec<f64> = values.iter().map(|value| value - mean).collect();
    let largest = differences.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    differences.iter_mut().for_each(|value| *value /= largest);
    let norm = differences
        .iter()
        .map(|value| value * value)
        .sum::<f64>()
        .sqrt();
    differences.iter_mut().for_each(|value| *value /= norm);
    differences
}

fn fisher(r: f64, pairs: usize, variance: f64) -> Option<Interval> {
    let freedom = pairs.checked_sub(3).filter(|freedom| *freedom > 0)?;
    let width = Z95 * (variance / freedom as f64).sqrt();
    let z = r.atanh();
    Some(Interval {
        low: (z - width).tanh(),
        high: (z + width).tanh(),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn pearson_of_four_pairs() {
        // Differences (-1.5, -.5, .5, 1.5) and (-.5, -1.5, 1.5, .5): 3 of 5.
        let found = pearson(&[1.0, 2.0, 3.0, 4.0], &[2.0, 1.0, 4.0, 3.0]).unwrap();
        assert!((found.r - 0.6).abs() < 1e-12);
        let interval = found.interval.unwrap();
        assert!((interval.high - (0.6_f64.atanh() + Z95).tanh()).abs() < 1e-12);
        assert_eq!(
            pearson(&[1.0, 2.0, 3.0], &[2.0, 1.0, 4.0])
                .unwrap()
                .interval,
            None
        );
    }

    #[test]
    fn undefined_correlations_are_named() {
        let constant = pearson(&[0.1, 0.1, 0.1], &[1.0, 2.0, 3.0]);
        assert_eq!(constant, Err(MetricError::Constant { what: "values" }));
        let nan = spearman(&[0.1, f64::NAN, 0.1], &[1.0, 2.0, 3.0]).unwrap_err();
        assert!(matches!(nan, MetricError::NotFinite { index: 1, .. }));
        assert!(matches!(
            pearson(&[1.0], &[1.0]),
            Err(MetricError::TooFew { .. })
        ));
        assert!(matches!(
            pearson(&[1.0], &[]),
            Err(MetricError::Length { .. })
        ));
    }

    #[test]
    fn perfect_correlation_has_zero_width() {
        let found = pearson(&[1.0, 2.0, 3.0, 4.0, 5.0], &[-2.0, -4.0, -6.0, -8.0, -10.0]).unwrap();
        assert!((found.r + 1.0).abs() < 1e-12);
        let interval = found.interval.unwrap();
        assert!(interval.low >= -1.0 && interval.high < -0.999);
    }

    proptest! {
        #[test]
        fn spearman_depends_only_on_the_order(pairs in prop::collection::vec((-50_i8..50, -50_i8..50), 4..40)) {
            let (x, y): (Vec<f64>, Vec<f64>) = pairs.iter().map(|(x, y)| (f64::from(*x), f64::from(*y))).unzip();
            let bent: Vec<f64> = x.iter().map(|x| (x / 20.0).exp() + x).collect();
            prop_assert_eq!(spearman(&x, &y).ok(), spearman(&bent, &y).ok());
            let sides = (spearman(&x, &y).ok(), spearman(&y, &x).ok());
            prop_assert_eq!(sides.0.map(|found| found.r), sides.1.map(|found| found.r));
        }

        #[test]
        fn pearson_is_scale_invariant(x in prop::collection::vec(-1e3_f64..1e3, 5), y in prop::collection::vec(-1e3_f64..1e3, 5), scale in 1e-3_f64..1e3) {
            let scaled: Vec<f64> = x.iter().map(|x| scale * x + 3.0).collect();
            if let (Ok(a), Ok(b)) = (pearson(&x, &y), pearson(&scaled, &y)) {
                prop_assert!((a.r - b.r).abs() < 1e-6);
            }
        }
    }
}
