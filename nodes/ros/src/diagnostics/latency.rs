//! The latency of a stage: percentiles over the last 30 to 60 s.

use hdrhistogram::Histogram;
use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

/// After this time a new histogram is begun; reports cover it and the one before.
const GENERATION: Duration = Duration::from_secs(30);

/// Records the latency of a stage. Clones share the record.
#[derive(Clone, Debug, Default)]
pub struct Latency {
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// Microseconds; made at the first record, 1 us to 10 minutes at 2 digits: 20 kB.
    current: Option<Histogram<u64>>,
    previous: Option<Histogram<u64>>,
    began: Option<Instant>,
}

/// Percentiles \[ms\].
#[derive(Clone, Copy, Debug)]
pub(super) struct Summary {
    pub(super) p50_ms: f64,
    pub(super) p95_ms: f64,
    pub(super) p99_ms: f64,
    pub(super) samples: u64,
}

/// The longest latency that is distinguished from longer ones \[us\]: 10 minutes.
const MAX_US: u64 = 600_000_000;

impl Latency {
    /// Records one duration.
    pub fn record(&self, duration: Duration) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        // longer ones count as the longest
        let micros = u64::try_from(duration.as_micros()).unwrap_or(MAX_US);
        let current = &mut state.current;
        if current.is_none() {
            // cannot fail: the bounds are constants that satisfy its conditions
            *current = Histogram::new_with_bounds(1, MAX_US, 2).ok();
        }
        if let Some(histogram) = current {
            histogram.saturating_record(micros);
        }
    }

    pub(super) fn summary(&self, now: Instant) -> Option<Summary> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let began = *state.began.get_or_insert(now);
        if now.saturating_duration_since(began) > GENERATION {
            state.previous = state.current.take();
            state.began = Some(now);
        }
        let both = match (&state.current, &state.previous) {
            (None, None) => return None,
            (Some(one), None) | (None, Some(one)) => one.clone(),
            (Some(current), Some(previous)) => {
                let mut both = current.clone();
                both.add(previous).ok()?;
                both
            }
        };
        // microseconds below 2^53
        let millis = |quantile| both.value_at_quantile(quantile) as f64 / 1000.0;
        Some(Summary {
            p50_ms: millis(0.5),
            p95_ms: millis(0.95),
            p99_ms: millis(0.99),
            samples: both.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_within_two_digits_and_old_ones_go() {
        let latency = Latency::default();
        let start = Instant::now();
        assert!(latency.summary(start).is_none());
        for millis in 1..=100 {
            latency.record(Duration::from_millis(millis));
        }
        let summary = latency.summary(start).unwrap();
        assert!((summary.p50_ms - 50.0).abs() < 1.0, "{summary:?}");
        assert!((summary.p95_ms - 95.0).abs() < 1.5, "{summary:?}");
        assert_eq!(summary.samples, 100);
        assert_eq!(
            latency
                .summary(start + Duration::from_secs(31))
                .map(|s| s.samples),
            Some(100)
        );
        assert!(latency.summary(start + Duration::from_secs(62)).is_none());
    }
}
