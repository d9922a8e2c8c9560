//! Rates of arrivals.

use std::collections::VecDeque;

/// The time span of a rate \[ns\].
const WINDOW_NS: i64 = 4_000_000_000;

/// The most arrivals: 4 s at 250 Hz; at higher rates the newest.
const LIMIT: usize = 1000;

#[derive(Debug, Default)]
pub(crate) struct Rate {
    arrivals: VecDeque<i64>,
    count: u64,
}

impl Rate {
    pub(crate) fn arrived(&mut self, now_ns: i64) {
        if self.arrivals.len() == LIMIT {
            self.arrivals.pop_front();
        }
        self.arrivals.push_back(now_ns);
        self.count += 1;
    }

    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// Recent arrivals per second; 0 if they have ceased.
    pub(crate) fn hertz(&mut self, now_ns: i64) -> f64 {
        while let Some(first) = self.arrivals.front()
            && now_ns.saturating_sub(*first) > WINDOW_NS
        {
            self.arrivals.pop_front();
        }
        let (Some(first), Some(last)) = (self.arrivals.front(), self.arrivals.back()) else {
            return 0.0;
        };
        let span_ns = last.saturating_sub(*first);
        if span_ns <= 0 {
            return 0.0;
        }
        // at most LIMIT arrivals and seconds: exact in f64
        (self.arrivals.len() - 1) as f64 * 1e9 / span_ns as f64
    }

    /// Time since the last arrival \[ns\].
    pub(crate) fn age_ns(&self, now_ns: i64) -> Option<i64> {
        let last = self.arrivals.back()?;
        Some(now_ns.saturating_sub(*last).max(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_recent_arrivals_count() {
        let mut rate = Rate::default();
        for frame in 0..100 {
            rate.arrived(frame * 200_000_000);
        }
        let end = 99 * 200_000_000;
        assert!((rate.hertz(end) - 5.0).abs() < 1e-9);
        assert_eq!(rate.age_ns(end + 5), Some(5));
        assert_eq!((rate.count(), rate.hertz(end + 2 * WINDOW_NS)), (100, 0.0));
        for at in 0..10_000 {
            rate.arrived(end + at);
        }
        assert_eq!(rate.arrivals.len(), LIMIT);
    }
}
