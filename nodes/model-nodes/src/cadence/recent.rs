//! The last few times of runs and inputs.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// Runs that are kept; their median decides.
const RUNS: usize = 5;
/// Fewest runs for a result.
const FEWEST_RUNS: usize = 3;
/// Inputs over which the rate is measured.
const INPUTS: usize = 10;
/// Fewest that say anything.
const FEWEST_INPUTS: usize = 4;
/// A gap of so many mean ones, and at least a second, is a pause and no rate.
const PAUSE: u32 = 4;
const LEAST_PAUSE: Duration = Duration::from_secs(1);

/// How long the last few runs took.
#[derive(Clone, Debug, Default)]
pub(crate) struct Recent(VecDeque<Duration>);

impl Recent {
    pub fn push(&mut self, taken: Duration) {
        if self.0.len() == RUNS {
            self.0.pop_front();
        }
        self.0.push_back(taken);
    }

    pub fn scale(&mut self, factor: f64) {
        for taken in &mut self.0 {
            *taken = taken.mul_f64(factor.max(0.0));
        }
    }

    /// Half of them took no longer; none while there are too few.
    pub fn median(&self) -> Option<Duration> {
        if self.0.len() < FEWEST_RUNS {
            return None;
        }
        let mut sorted: Vec<Duration> = self.0.iter().copied().collect();
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied()
    }

    /// An estimate from before the runs, or the shortest of them: where one run took less, the estimate was wrong, and
    /// to wait for [`FEWEST_RUNS`] so far apart as it asks for would take long.
    pub fn at_most(&self, estimate: Option<Duration>) -> Option<Duration> {
        let shortest = self.0.iter().min().copied();
        estimate.map(|estimate| shortest.map_or(estimate, |shortest| shortest.min(estimate)))
    }

    /// The longest; none while there are too few.
    pub fn longest(&self) -> Option<Duration> {
        let longest = self.0.iter().max().copied();
        longest.filter(|_| self.0.len() >= FEWEST_RUNS)
    }
}

/// When an input came, and what it is stamped \[ns\].
type Arrival = (Instant, i64);

/// When the last few inputs came.
#[derive(Clone, Debug, Default)]
pub(crate) struct Arrivals(VecDeque<Arrival>);

impl Arrivals {
    /// An input comes. After a pause, or where stamps go back, the measurement begins anew.
    pub fn push(&mut self, now: Instant, stamp_ns: i64) {
        if let Some((last, last_ns)) = self.0.back().copied() {
            let gap = now.saturating_duration_since(last);
            let pause = self.gap().map_or(Duration::MAX, |mean| mean * PAUSE);
            if stamp_ns < last_ns || gap > pause.max(LEAST_PAUSE) {
                self.0.clear();
            }
        }
        if self.0.len() == INPUTS {
            self.0.pop_front();
        }
        self.0.push_back((now, stamp_ns));
    }

    /// From one input to the next, on average.
    pub fn gap(&self) -> Option<Duration> {
        let ((first, _), (last, _)) = self.ends()?;
        Some(last.saturating_duration_since(first) / self.gaps())
    }

    /// The same by their stamps \[ns\].
    pub fn stamp_gap_ns(&self) -> Option<i64> {
        let ((_, first_ns), (_, last_ns)) = self.ends()?;
        Some(last_ns.saturating_sub(first_ns) / i64::from(self.gaps()))
    }

    fn gaps(&self) -> u32 {
        // A handful.
        (self.0.len() as u32).saturating_sub(1).max(1)
    }

    /// The first and the last; none while there are too few.
    fn ends(&self) -> Option<(Arrival, Arrival)> {
        if self.0.len() < FEWEST_INPUTS {
            return None;
        }
        Some((*self.0.front()?, *self.0.back()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn a_hiccup_is_the_longest_and_not_the_median() {
        let mut recent = Recent::default();
        recent.push(SECOND);
        recent.push(SECOND);
        assert_eq!((recent.median(), recent.longest()), (None, None));
        recent.push(9 * SECOND);
        let judged = (recent.median(), recent.longest());
        assert_eq!(judged, (Some(SECOND), Some(9 * SECOND)));
        for _ in 0..5 {
            recent.push(2 * SECOND);
        }
        assert_eq!(recent.longest(), Some(2 * SECOND));
    }

    #[test]
    fn a_rate_is_measured_over_jitter_and_not_over_a_pause() {
        let begin = Instant::now();
        let mut arrivals = Arrivals::default();
        let jitter = [0, 30, 10, 60, 0, 20, 50, 0];
        for (tick, jitter) in (0_u64..).zip(jitter) {
            let at = begin + Duration::from_millis(200 * tick + jitter);
            arrivals.push(at, tick as i64 * 100_000_000);
        }
        assert_eq!(arrivals.gap(), Some(Duration::from_millis(200)));
        assert_eq!(arrivals.stamp_gap_ns(), Some(100_000_000));
        arrivals.push(begin + 60 * SECOND, 60_000_000_000);
        assert_eq!(arrivals.gap(), None);
        for tick in 1..4 {
            arrivals.push(
                begin + (60 + tick) * SECOND,
                60_000_000_000 + i64::from(tick),
            );
        }
        assert_eq!(arrivals.gap(), Some(SECOND));
        arrivals.push(begin + 64 * SECOND, 0);
        assert_eq!(arrivals.gap(), None, "time jumped back");
    }
}
