//! Limits a stream to a maximum frequency.

use std::time::Duration;

/// Admits at most this many samples per second: in any `t` seconds at most `t` x frequency + 2. A faster stream is
/// reduced to exactly its frequency in the long run.
#[derive(Debug)]
pub(crate) struct Limiter {
    period: Duration,
    /// When the next sample is due. It advances by whole periods, so that the jitter of a camera costs no frames.
    due: Duration,
}

impl Limiter {
    /// Admits one sample per `period`.
    pub(crate) fn new(period: Duration) -> Self {
        Self {
            period,
            due: Duration::ZERO,
        }
    }

    /// Whether to send a sample that arrives at `now`, counted from any fixed time.
    pub(crate) fn admits(&mut self, now: Duration) -> bool {
        if now < self.due {
            return false;
        }
        let on_schedule = self.due + self.period;
        self.due = if on_schedule > now {
            on_schedule
        } else {
            now + self.period
        };
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn admitted(period_ms: u64, times_ms: impl IntoIterator<Item = u64>) -> Vec<u64> {
        let mut limiter = Limiter::new(Duration::from_millis(period_ms));
        times_ms
            .into_iter()
            .filter(|&time| limiter.admits(Duration::from_millis(time)))
            .collect()
    }

    #[test]
    fn fast_stream_is_limited_and_slow_stream_is_unchanged() {
        // 30 Hz with jitter, limited to 10 Hz: a hundred in ten seconds
        let jittery = (0..300).map(|frame| 1000 + frame * 100 / 3 + frame * 7919 % 11);
        assert_eq!(admitted(100, jittery).len(), 100);
        let slow: Vec<u64> = (0..50).map(|frame| frame * 200).collect();
        assert_eq!(admitted(100, slow.clone()), slow);
    }

    proptest! {
        #[test]
        fn no_time_window_exceeds_the_limit(period in 1u64..200, mut times in prop::collection::vec(0u64..5000, 0..300)) {
            times.sort_unstable();
            let passed = admitted(period, times);
            for (first, &start) in passed.iter().enumerate() {
                for (count, &end) in passed[first..].iter().enumerate() {
                    prop_assert!(count as u64 <= (end - start) / period + 1);
                }
            }
        }
    }
}
