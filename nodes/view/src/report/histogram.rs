//! Durations in a histogram of fixed size.

use super::figures::Percentiles;
use hdrhistogram::Histogram;

/// Durations above an hour are ignored \[ns\]: they mean that two clocks are unrelated.
const LIMIT_NS: u64 = 3_600_000_000_000;

#[derive(Clone, Debug)]
pub(super) struct Times {
    histogram: Option<Histogram<u64>>,
}

impl Times {
    pub(crate) fn new() -> Self {
        // Two significant digits give percentiles within 1 %. The bounds are constants that the crate accepts.
        Self {
            histogram: Histogram::new_with_bounds(1_000, LIMIT_NS, 2).ok(),
        }
    }

    /// Counts a duration unless it is negative or longer than an hour.
    pub(crate) fn record(&mut self, time_ns: i64) {
        let time_ns = u64::try_from(time_ns)
            .ok()
            .filter(|time_ns| *time_ns <= LIMIT_NS);
        if let (Some(histogram), Some(time_ns)) = (&mut self.histogram, time_ns) {
            histogram.saturating_record(time_ns);
        }
    }

    pub(crate) fn percentiles(&self) -> Option<Percentiles> {
        let histogram = self
            .histogram
            .as_ref()
            .filter(|histogram| !histogram.is_empty())?;
        let milliseconds = |quantile| histogram.value_at_quantile(quantile) as f64 / 1e6;
        Some(Percentiles {
            n: histogram.len(),
            p50_ms: milliseconds(0.5),
            p95_ms: milliseconds(0.95),
            p99_ms: milliseconds(0.99),
            max_ms: histogram.max() as f64 / 1e6,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_within_a_percent() {
        let mut times = Times::new();
        assert_eq!(times.percentiles(), None);
        for milliseconds in 1..=100 {
            times.record(milliseconds * 1_000_000);
        }
        times.record(-5);
        times.record(i64::MAX);
        let percentiles = times.percentiles().unwrap();
        assert_eq!(percentiles.n, 100);
        for (value, expected) in [
            (percentiles.p50_ms, 50.0),
            (percentiles.p95_ms, 95.0),
            (percentiles.p99_ms, 99.0),
        ] {
            assert!(
                (value - expected).abs() <= expected * 0.01,
                "{value} against {expected}"
            );
        }
    }
}
