use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Interval;
use crate::{
    MetricError,
    error::{finite, mean, same_length},
};

/// Settings of a bootstrap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bootstrap {
    /// Number of resamples.
    pub resamples: usize,
    /// Seed of ChaCha8; each resample has its own stream, so threads do not affect results.
    pub seed: u64,
    /// Share of the resamples within the interval, between 0 and 1.
    pub level: f64,
}

impl Default for Bootstrap {
    /// 10 000 resamples, seed 0, 95 %.
    fn default() -> Self {
        Self {
            resamples: 10_000,
            seed: 0,
            level: 0.95,
        }
    }
}

/// A value and its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Value for the samples themselves.
    pub value: f64,
    /// Percentile interval: quantiles of the resamples, interpolated as NumPy's `percentile`.
    pub interval: Interval,
    /// Standard deviation over the resamples.
    pub standard_error: f64,
    /// Share of the resamples at or below 0: for a difference, the one-sided p of the bootstrap. It is 0 below 1 /
    /// resamples.
    pub not_above_zero: f64,
}

/// Percentile bootstrap of any statistic of `count` samples. `statistic` receives `count` drawn indices below `count`;
/// for the value itself, each index once and in order.
///
/// # Errors
/// [`MetricError::Empty`] without samples; [`MetricError::Range`] for the settings; [`MetricError::NotFinite`] if the
/// statistic of a resample is not finite.
pub fn bootstrap(
    count: usize,
    settings: &Bootstrap,
    statistic: impl Fn(&[usize]) -> f64 + Sync,
) -> Result<Estimate, MetricError> {
    let own: Vec<usize> = (0..count).collect();
    let drawn = replicates(count, settings, &statistic)?;
    Estimate::of_replicates(statistic(&own), drawn, settings.level)
}

/// The statistic of every resample of [`bootstrap`], in order. With equal counts and settings, two statistics use the
/// same draws, so their pairwise differences are replicates of the difference.
///
/// # Errors
/// Those of [`bootstrap`].
pub fn replicates(
    count: usize,
    settings: &Bootstrap,
    statistic: impl Fn(&[usize]) -> f64 + Sync,
) -> Result<Vec<f64>, MetricError> {
    if count == 0 {
        return Err(MetricError::Empty);
    }
    draw_all(settings, |random| {
        let drawn: Vec<usize> = (0..count).map(|_| random.random_range(0..count)).collect();
        statistic(&drawn)
    })
}

impl Estimate {
    /// An estimate from a value and its replicates: those of [`replicates`], or their differences.
    ///
    /// # Errors
    /// [`MetricError::NotFinite`]; [`MetricError::Range`] for fewer than two replicates, or a level not between 0 and
    /// 1.
    pub fn of_replicates(
        value: f64,
        mut replicates: Vec<f64>,
        level: f64,
    ) -> Result<Self, MetricError> {
        let range = |what, expected, actual| MetricError::Range {
            what,
            expected,
            actual,
        };
        if replicates.len() < 2 {
            let actual = replicates.len().to_string();
            return Err(range("the number of resamples", "at least 2", actual));
        }
        if !(level > 0.0 && level < 1.0) {
            let actual = level.to_string();
            return Err(range("the level", "between 0 and 1", actual));
        }
        finite(
            "statistics of resamples",
            replicates.iter().copied().chain([value]),
        )?;
        let middle = mean(&replicates);
        let squares: f64 = replicates.iter().map(|own| (own - middle).powi(2)).sum();
        finite("squares of the statistics", [squares])?;
        let not_above_zero = replicates.iter().filter(|own| **own <= 0.0).count();
        replicates.sort_unstable_by(f64::total_cmp);
        let tail = (1.0 - level) / 2.0;
        let count = replicates.len() as f64;
        Ok(Self {
            value,
            interval: Interval {
                low: quantile(&replicates, tail),
                high: quantile(&replicates, 1.0 - tail),
            },
            standard_error: (squares / (count - 1.0)).sqrt(),
            not_above_zero: not_above_zero as f64 / count,
        })
    }
}

/// [`bootstrap`] of a mean. SciPy's `bootstrap(method="percentile")` draws different numbers from the same
/// distribution.
///
/// # Errors
/// Those of [`bootstrap`]; [`MetricError::NotFinite`] for the values.
pub fn bootstrap_mean(values: &[f64], settings: &Bootstrap) -> Result<Estimate, MetricError> {
    finite("values", values.iter().copied())?;
    bootstrap(values.len(), settings, |drawn| {
        let drawn = drawn.iter().filter_map(|index| values.get(*index));
        drawn.sum::<f64>() / values.len() as f64
    })
}

/// [`bootstrap`] of the mean difference `first` - `second` of paired samples, for example by task; both sides use the
/// same draws. The paper's "paired bootstrap over tasks".
///
/// # Errors
/// Those of [`bootstrap_mean`]; [`MetricError::Length`].
pub fn bootstrap_paired_difference(
    first: &[f64],
    second: &[f64],
    settings: &Bootstrap,
) -> Result<Estimate, MetricError> {
    same_length(first.len(), second.len())?;
    let differences: Vec<f64> = first.iter().zip(second).map(|(a, b)| a - b).collect();
    bootstrap_mean(&differences, settings)
}

/// An estimate from the results of `draw`.
pub(super) fn resample(
    settings: &Bootstrap,
    value: f64,
    draw: impl Fn(&mut ChaCha8Rng) -> f64 + Sync,
) -> Result<Estimate, MetricError> {
    Estimate::of_replicates(value, draw_all(settings, draw)?, settings.level)
}

/// Draws all resamples, in their order.
fn draw_all(
    settings: &Bootstrap,
    draw: impl Fn(&mut ChaCha8Rng) -> f64 + Sync,
) -> Result<Vec<f64>, MetricError> {
    let drawn = (0..settings.resamples as u64)
        .into_par_iter()
        .map(|stream| {
            let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
            random.set_stream(stream);
            draw(&mut random)
        });
    Ok(drawn.collect())
}

/// A quantile of sorted values, interpolated linearly.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() as f64 - 1.0);
    // An integer from 0 to below the length.
    let below = place.floor() as usize;
    // Callers pass at least two values; the index past the end has weight 0.
    let at = |index: usize| sorted.get(index).or(sorted.last()).copied().unwrap_or(0.0);
    let (low, high) = (at(below), at(below + 1));
    low + (high - low) * (place - place.floor())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn quantiles_match_numpy() {
        let sorted = [1.0, 2.0, 4.0, 8.0];
        assert_eq!(quantile(&sorted, 0.5), 3.0);
        assert!((quantile(&sorted, 0.9) - 6.8).abs() < 1e-12);
        assert_eq!((quantile(&sorted, 0.0), quantile(&sorted, 1.0)), (1.0, 8.0));
    }

    #[test]
    fn interval_of_coin_flips() {
        // The resampled mean of 50 heads in 100 is binomial: 0.5 +- 1.96 x 0.05.
        let values: Vec<f64> = (0..100).map(|i| f64::from(i % 2)).collect();
        let found = bootstrap_mean(&values, &Bootstrap::default()).unwrap();
        assert_eq!(found.value, 0.5);
        assert!((found.standard_error - 0.05).abs() < 0.002);
        assert!((found.interval.low - 0.4).abs() <= 0.01 + 1e-12);
        assert!((found.interval.high - 0.6).abs() <= 0.01 + 1e-12);
        assert_eq!(found.not_above_zero, 0.0);
    }

    #[test]
    fn replicates_of_the_same_draws_are_paired() {
        let first = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0];
        let second = [2.0, 7.0, 1.0, 8.0, 2.0, 8.0];
        let settings = Bootstrap::default();
        let of = |values: &[f64; 6]| {
            let mean = |drawn: &[usize]| drawn.iter().map(|i| values[*i]).sum::<f64>() / 6.0;
            (
                mean(&[0, 1, 2, 3, 4, 5]),
                replicates(6, &settings, mean).unwrap(),
            )
        };
        let ((a, ours), (b, theirs)) = (of(&first), of(&second));
        let differences = ours.iter().zip(&theirs).map(|(a, b)| a - b).collect();
        let found = Estimate::of_replicates(a - b, differences, 0.95).unwrap();
        let expected = bootstrap_paired_difference(&first, &second, &settings).unwrap();
        assert!((found.interval.low - expected.interval.low).abs() < 1e-12);
        assert!((found.interval.high - expected.interval.high).abs() < 1e-12);
    }

    #[test]
    fn result_does_not_depend_on_threads() {
        let values: Vec<f64> = (0..37).map(|i| f64::from(i * i % 11)).collect();
        let settings = Bootstrap {
            resamples: 500,
            ..Bootstrap::default()
        };
        let of = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| bootstrap_mean(&values, &settings).unwrap())
        };
        assert_eq!(of(1), of(3));
        let other = Bootstrap {
            seed: 1,
            ..settings
        };
        assert_ne!(of(1), bootstrap_mean(&values, &other).unwrap());
    }

    #[test]
    fn invalid_input_is_named() {
        let settings = Bootstrap::default();
        assert_eq!(bootstrap_mean(&[], &settings), Err(MetricError::Empty));
        assert!(bootstrap_mean(&[f64::NAN], &settings).is_err());
        assert!(bootstrap(3, &settings, |_| f64::NAN).is_err());
        for bad in [
            Bootstrap {
                resamples: 1,
                ..settings
            },
            Bootstrap {
                level: 1.0,
                ..settings
            },
        ] {
            let error = bootstrap_mean(&[1.0, 2.0], &bad).unwrap_err();
            assert!(matches!(error, MetricError::Range { .. }));
        }
        let ragged = bootstrap_paired_difference(&[1.0], &[1.0, 2.0], &settings);
        assert!(matches!(ragged, Err(MetricError::Length { .. })));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn bootstrap_is_deterministic(values in prop::collection::vec(-1e3_f64..1e3, 1..30), seed: u64) {
            let settings = Bootstrap { resamples: 50, seed, level: 0.9 };
            let found = bootstrap_mean(&values, &settings).unwrap();
            prop_assert_eq!(found, bootstrap_mean(&values, &settings).unwrap());
            prop_assert!(found.interval.low <= found.interval.high);
            let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(*value), high.max(*value)));
            prop_assert!(found.interval.low >= low - 1e-9 && found.interval.high <= high + 1e-9);
        }
    }
}
