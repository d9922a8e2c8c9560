use serde::{Deserialize, Serialize};

use crate::{
    MetricError,
    error::{at_least, finite, mean},
};

/// 97.5 % quantile of the normal distribution.
pub(crate) const Z95: f64 = 1.959_963_984_540_054;

/// An interval in the unit of the value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// Whether it contains a value, ends included.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }
}

/// 95 % interval of a success rate after Wilson 1927. It stays within \[0, 1\] and has a width at 0 and 1, unlike a
/// bootstrap.
///
/// # Errors
/// [`MetricError::Empty`] without trials; [`MetricError::Range`] if successes exceed trials.
pub fn wilson(successes: usize, trials: usize) -> Result<Interval, MetricError> {
    let share = share(successes, trials)?;
    let (is_none, is_all) = (successes == 0, successes == trials);
    let (trials, square) = (trials as f64, Z95 * Z95);
    let middle = (share + square / (2.0 * trials)) / (1.0 + square / trials);
    let spread = share * (1.0 - share) / trials + square / (4.0 * trials * trials);
    let width = Z95 / (1.0 + square / trials) * spread.sqrt();
    Ok(Interval {
        // Exactly 0 or 1, without rounding errors.
        low: if is_none { 0.0 } else { middle - width },
        high: if is_all { 1.0 } else { middle + width },
    })
}

/// Standard error of a mean: unbiased standard deviation / root of the count.
///
/// # Errors
/// [`MetricError::TooFew`] below two values; [`MetricError::NotFinite`].
pub fn standard_error(values: &[f64]) -> Result<f64, MetricError> {
    at_least("values", 2, values.len())?;
    finite("values", values.iter().copied())?;
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let count = values.len() as f64;
    finite("squares of the values", [squares])?;
    Ok((squares / (count - 1.0) / count).sqrt())
}

/// Standard error of a success rate, (p (1 - p) / n)^1/2: the "+-" of the paper's success rates.
///
/// # Errors
/// Those of [`wilson`].
pub fn standard_error_of_share(successes: usize, trials: usize) -> Result<f64, MetricError> {
    let share = share(successes, trials)?;
    Ok((share * (1.0 - share) / trials as f64).sqrt())
}

fn share(successes: usize, trials: usize) -> Result<f64, MetricError> {
    if trials == 0 {
        return Err(MetricError::Empty);
    }
    if successes > trials {
        return Err(MetricError::Range {
            what: "successes",
            expected: "at most as many as trials",
            actual: format!("{successes} of {trials}"),
        });
    }
    Ok(successes as f64 / trials as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn wilson_interval_of_none_and_all() {
        // For zero successes the upper end is z^2 / (n + z^2).
        let none = wilson(0, 10).unwrap();
        assert!(none.low.abs() < 1e-12);
        assert!((none.high - Z95 * Z95 / (10.0 + Z95 * Z95)).abs() < 1e-12);
        let all = wilson(10, 10).unwrap();
        assert!((all.low - (1.0 - none.high)).abs() < 1e-12 && all.contains(1.0));
        assert!(matches!(wilson(2, 1), Err(MetricError::Range { .. })));
        assert_eq!(wilson(0, 0), Err(MetricError::Empty));
    }

    #[test]
    fn standard_errors_of_means() {
        let found = standard_error(&[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((found - (5.0_f64 / 3.0 / 4.0).sqrt()).abs() < 1e-12);
        assert!((standard_error_of_share(1, 4).unwrap() - (3.0_f64 / 64.0).sqrt()).abs() < 1e-12);
        assert!(standard_error(&[1.0]).is_err());
        assert!(standard_error(&[1.0, f64::INFINITY]).is_err());
    }
}
