use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{
    MetricError,
    error::{finite, mean},
};

/// Most differences with enumeration of all signs: each half has 2^20 sums.
const ENUMERATED: usize = 40;
/// Greatest sum of differences, in common units, for the convolution.
const UNITS: u64 = 1 << 20;
/// Greatest distance of a difference to a multiple of the unit, as a share of the greatest difference. Means of trials
/// have rounding errors of 1e-16; a unit below 1e-6 is not meaningful.
const TOLERANCE: f64 = 1e-9;

/// Settings for sampled sign patterns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignFlip {
    /// Number of sign patterns.
    pub resamples: usize,
    /// Seed of ChaCha8.
    pub seed: u64,
}

impl Default for SignFlip {
    /// 100 000 patterns, seed 0.
    fn default() -> Self {
        Self {
            resamples: 100_000,
            seed: 0,
        }
    }
}

/// How p was computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Method {
    /// Exactly, by convolution: the differences are multiples of a common unit, as differences of success rates are.
    Convolved,
    /// Exactly, by counting all sign patterns.
    Enumerated,
    /// Estimated from random sign patterns as (1 + hits) / (1 + drawn), which is never 0.
    MonteCarlo {
        /// Sign patterns drawn.
        resamples: usize,
    },
}

/// Result of [`sign_flip_test`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SignFlipTest {
    /// Mean of the differences.
    pub mean: f64,
    /// Share of the sign patterns whose sum is at least the observed one.
    pub p: f64,
    /// How p was computed.
    pub method: Method,
}

/// One-sided sign-flip test of paired differences. p is the probability of a sum at least as large as the observed one
/// if all signs are equally likely; it is small for differences above 0, so negate them if lower is better. The paper's
/// "exact one-sided sign-flip test over the 20 shared task episodes", and SciPy's `permutation_test` of the mean with
/// `permutation_type="samples"` and `alternative="greater"`.
///
/// Differences of 0 are skipped; if all are 0, p is 1. For up to 40 others, or any number of multiples of a common
/// unit, p is exact, otherwise estimated.
///
/// # Errors
/// [`MetricError::Empty`], [`MetricError::NotFinite`].
pub fn sign_flip_test(
    differences: &[f64],
    settings: &SignFlip,
) -> Result<SignFlipTest, MetricError> {
    if differences.is_empty() {
        return Err(MetricError::Empty);
    }
    finite("differences", differences.iter().copied())?;
    let size = differences.iter().map(|d| d.abs()).sum();
    finite("sums of differences", [size])?;
    let moving: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0).collect();
    let (p, method) = if let Some(p) = convolved(&moving) {
        (p, Method::Convolved)
    } else if moving.len() <= ENUMERATED {
        (enumerated(&moving), Method::Enumerated)
    } else {
        let resamples = settings.resamples.max(1);
        let p = drawn(&moving, resamples, settings.seed);
        (p, Method::MonteCarlo { resamples })
    };
    Ok(SignFlipTest {
        mean: mean(differences),
        p,
        method,
    })
}

/// p from the distribution of the sum of positive differences; `None` without a common unit.
fn convolved(differences: &[f64]) -> Option<f64> {
    let unit = common_unit(differences)?;
    // Integers up to UNITS.
    let units = |difference: &f64| (difference.abs() / unit).round() as u64;
    let total = differences.iter().map(units).sum::<u64>();
    if total > UNITS {
        return None;
    }
    let observed: u64 = differences.iter().filter(|d| **d > 0.0).map(units).sum();
    let mut shares = vec![1.0_f64];
    for difference in differences {
        let stays = shares.iter().map(|share| share / 2.0);
        let shift = usize::try_from(units(difference)).ok()?;
        let mut next: Vec<f64> = stays.chain(std::iter::repeat_n(0.0, shift)).collect();
        for (next, share) in next.iter_mut().skip(shift).zip(&shares) {
            *next += share / 2.0;
        }
        shares = next;
    }
    let from = usize::try_from(observed).ok()?;
    // Smallest first, so that a small p keeps its digits.
    Some(shares.iter().skip(from).rev().sum::<f64>().min(1.0))
}

/// The largest unit of all differences, by Euclid's algorithm; 1 if empty.
fn common_unit(differences: &[f64]) -> Option<f64> {
    let Some(largest) = differences.iter().map(|d| d.abs()).max_by(f64::total_cmp) else {
        return Some(1.0);
    };
    let floor = largest * 1e-6;
    let mut unit = largest;
    for difference in differences {
        let mut other = difference.abs();
        while other > floor {
            let rest = unit % other;
            // The rest of a multiple may be just below the divisor.
            let rest = if other - rest < floor { 0.0 } else { rest };
            (unit, other) = (other, rest);
        }
    }
    // Rests accumulate rounding errors; the largest difference has none.
    let unit = largest / (largest / unit).round();
    let fits = |difference: &f64| {
        let units = difference.abs() / unit;
        (units - units.round()).abs() * unit <= largest * TOLERANCE && units.round() >= 1.0
    };
    differences.iter().all(fits).then_some(unit)
}

/// p by counting: sums of one half of the differences against sorted sums of the other.
fn enumerated(differences: &[f64]) -> f64 {
    let (left, right) = differences.split_at(differences.len() / 2);
    let (left, mut right) = (flipped(left), flipped(right));
    right.sort_unstable_by(f64::total_cmp);
    let least = least(differences);
    let hits: u64 = left
        .par_iter()
        .map(|sum| (right.len() - right.partition_point(|other| sum + other < least)) as u64)
        .sum();
    // At most 2^40 patterns: exact in f64.
    hits as f64 / (left.len() as f64 * right.len() as f64)
}

fn flipped(differences: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0];
    for difference in differences {
        let sums_of = |sign: f64| sums.iter().map(move |sum| sum + sign * difference);
        sums = sums_of(1.0).chain(sums_of(-1.0)).collect();
    }
    sums
}

/// The observed sum less its rounding error, so that an equal sum in another order counts.
fn least(differences: &[f64]) -> f64 {
    let size: f64 = differences.iter().map(|d| d.abs()).sum();
    differences.iter().sum::<f64>() - size * 1e-13
}

fn drawn(differences: &[f64], resamples: usize, seed: u64) -> f64 {
    let least = least(differences);
    let hits = (0..resamples as u64).into_par_iter().filter(|stream| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(*stream);
        let signs = differences.iter().map(|difference| {
            if random.random::<bool>() {
                *difference
            } else {
                -difference
            }
        });
        signs.sum::<f64>() >= least
    });
    (1.0 + hits.count() as f64) / (1.0 + resamples as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    fn test(differences: &[f64]) -> SignFlipTest {
        sign_flip_test(differences, &SignFlip::default()).unwrap()
    }

    #[test]
    fn p_of_three_differences() {
        // Of 8 patterns of 1, 2, 4 only +++ gives 7, and -++ 5.
        assert_eq!(test(&[1.0, 2.0, 4.0]).p, 1.0 / 8.0);
        assert_eq!(test(&[-1.0, 2.0, 4.0]).p, 2.0 / 8.0);
        assert_eq!(test(&[-1.0, -2.0, -4.0]).p, 1.0);
        assert_eq!(test(&[0.0, 0.0]).p, 1.0);
        let irrational = test(&[1.0, std::f64::consts::SQRT_2, 0.0, std::f64::consts::PI]);
        assert_eq!(
            (irrational.p, irrational.method),
            (1.0 / 8.0, Method::Enumerated)
        );
    }

    #[test]
    fn means_of_trials_have_a_common_unit() {
        let thirds = [
            1.0 / 3.0,
            0.5 - 1.0 / 3.0,
            5.0 / 24.0,
            0.1 + 0.2 - 0.3 + 1.0 / 24.0,
        ];
        let unit = common_unit(&thirds).unwrap();
        assert!((unit - 1.0 / 24.0).abs() < 1e-12, "{unit}");
        assert_eq!(test(&thirds).method, Method::Convolved);
    }

    #[test]
    fn estimated_p_is_close_to_exact() {
        // 60 ones, 40 of them positive: a binomial tail.
        let ones: Vec<f64> = (0..60).map(|i| if i < 38 { 1.0 } else { -1.0 }).collect();
        let exact = test(&ones);
        assert_eq!(exact.method, Method::Convolved);
        let bent: Vec<f64> = (0..60)
            .map(|i| ones[i] * (1.0 + (i as f64 * 1e-5).sin()))
            .collect();
        let found = test(&bent);
        assert_eq!(found.method, Method::MonteCarlo { resamples: 100_000 });
        assert!(
            (found.p - exact.p).abs() < 0.01,
            "{} against {}",
            found.p,
            exact.p
        );
        assert_eq!(found, test(&bent));
        assert!(found.p > 0.0);
    }

    #[test]
    fn invalid_input_is_named() {
        let settings = SignFlip::default();
        assert_eq!(sign_flip_test(&[], &settings), Err(MetricError::Empty));
        assert!(sign_flip_test(&[f64::NAN], &settings).is_err());
    }

    proptest! {
        #[test]
        fn exact_p_equals_brute_force(units in prop::collection::vec(-9_i32..9, 1..12), scale in 0.01_f64..10.0, bend: bool) {
            let differences: Vec<f64> = units.iter().enumerate().map(|(i, units)| {
                f64::from(*units) * scale + if bend { (i as f64 * 0.37 + 0.1).sqrt() * scale } else { 0.0 }
            }).collect();
            let sum = |pattern: u32| -> f64 {
                let signs = differences.iter().enumerate();
                signs.map(|(i, d)| if pattern >> i & 1 == 0 { *d } else { -d }).sum()
            };
            let patterns = 1_u32 << differences.len();
            let hits = (0..patterns).filter(|pattern| sum(*pattern) >= sum(0) - 1e-9 * scale).count();
            let found = test(&differences);
            prop_assert!((found.p - hits as f64 / f64::from(patterns)).abs() < 1e-12, "{found:?}");
        }
    }
}
