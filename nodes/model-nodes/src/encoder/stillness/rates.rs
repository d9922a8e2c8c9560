//! The rates of frames and of new pictures.

use std::collections::VecDeque;

/// Span of time that rates are measured over \[ns\].
const SPAN_NS: i64 = 2_000_000_000;
/// Least and greatest number of frames in it.
const LEAST: usize = 8;
const MOST: usize = 256;
/// Least number of new frames in it for a steady rate.
const LEAST_NEW: usize = 4;
/// With more repetitions of one picture in a row, the camera has stopped.
const MOST_REPEATS: usize = 4;
/// Least number of new frames with repetitions after them for a steady rate.
const LEAST_RUNS: usize = 3;
/// Least part of repeated frames for which a camera counts as repeating.
const REPEATED: f64 = 0.2;

/// The last frames: stamp, and whether the picture was new.
#[derive(Clone, Debug, Default)]
pub(in crate::encoder) struct Rates(VecDeque<(i64, bool)>);

impl Rates {
    /// Takes a frame. If its stamp goes back, measuring begins anew; a stamp that comes again is skipped.
    pub fn push(&mut self, stamp_ns: i64, is_new: bool) {
        match self.0.back() {
            Some((last_ns, _)) if stamp_ns == *last_ns => return,
            Some((last_ns, _)) if stamp_ns < *last_ns => self.0.clear(),
            _ => {}
        }
        self.0.push_back((stamp_ns, is_new));
        let oldest_ns = stamp_ns.saturating_sub(SPAN_NS);
        while self.0.len() > MOST
            || (self.0.len() > LEAST
                && self
                    .0
                    .front()
                    .is_some_and(|(first_ns, _)| *first_ns < oldest_ns))
        {
            self.0.pop_front();
        }
    }

    /// Frames per second \[Hz\]; `None` before enough have come.
    pub fn rate(&self) -> Option<f64> {
        self.per_second(self.0.len().saturating_sub(1))
    }

    /// New frames per second \[Hz\]; `None` before enough have come.
    pub fn distinct_rate(&self) -> Option<f64> {
        self.per_second(self.0.iter().skip(1).filter(|(_, is_new)| *is_new).count())
    }

    fn per_second(&self, count: usize) -> Option<f64> {
        let ((first_ns, _), (last_ns, _)) = (self.0.front()?, self.0.back()?);
        let span_s = last_ns.saturating_sub(*first_ns) as f64 / 1e9;
        // A window has at most some hundred frames.
        (self.0.len() >= LEAST && span_s > 0.0).then(|| count as f64 / span_s)
    }

    /// Whether new frames come steadily between repeated ones: a camera that is published faster than it takes pictures,
    /// and not one that has stopped, or a scene that is still between motions.
    pub fn is_repeating(&self) -> bool {
        let repeats = self.0.iter().filter(|(_, is_new)| !is_new).count();
        let news = self.0.len() - repeats;
        if self.0.len() < LEAST
            || news < LEAST_NEW
            || (repeats as f64) < REPEATED * self.0.len() as f64
        {
            return false;
        }
        // A camera's rate has about as many repetitions after each new frame.
        let most = (repeats.div_ceil(news) + 1).min(MOST_REPEATS);
        let (mut run, mut longest, mut runs) = (0, 0, 0);
        for (_, is_new) in &self.0 {
            run = if *is_new { 0 } else { run + 1 };
            longest = longest.max(run);
            runs += usize::from(run == 1);
        }
        runs >= LEAST_RUNS && longest <= most
    }

    pub fn clear(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rates(count: i64, is_new: impl Fn(i64) -> bool) -> Rates {
        let mut rates = Rates::default();
        for index in 0..count {
            rates.push(index * 1_000_000_000 / 30, is_new(index));
        }
        rates
    }

    #[test]
    fn a_camera_that_repeats_has_two_rates() {
        let every = rates(90, |_| true);
        assert!((every.rate().unwrap() - 30.0).abs() < 0.5 && !every.is_repeating());
        let second = rates(90, |index| index % 2 == 0);
        assert!(second.is_repeating());
        assert!((second.rate().unwrap() - 30.0).abs() < 0.5);
        assert!((second.distinct_rate().unwrap() - 15.0).abs() < 0.6);
        // Two of five.
        assert!(rates(90, |index| ![1, 3].contains(&(index % 5))).is_repeating());
    }

    #[test]
    fn a_camera_that_stops_or_starts_does_not_count_as_repeating() {
        assert!(!rates(90, |_| false).is_repeating());
        assert!(!rates(90, |index| index < 60).is_repeating());
        assert!(!rates(90, |index| index > 60).is_repeating());
        assert_eq!(rates(5, |_| true).rate(), None);
    }

    #[test]
    fn a_scene_that_is_still_between_motions_is_no_rate() {
        // 5 Hz: the arm moves for 1.4 s and rests for 0.8 s
        let mut rates = Rates::default();
        for index in 0..200 {
            rates.push(index * 200_000_000, index % 11 < 7);
            assert!(!rates.is_repeating(), "{index}");
        }
    }

    #[test]
    fn a_camera_that_stops_has_no_lower_rate_before() {
        let mut rates = rates(90, |_| true);
        for index in 90..150 {
            rates.push(index * 1_000_000_000 / 30, false);
            assert!(!rates.is_repeating(), "{index}");
        }
    }

    #[test]
    fn stamps_that_go_back_begin_anew_and_memory_is_bounded() {
        let mut rates = rates(90, |_| true);
        let before = rates.rate();
        rates.push(89 * 1_000_000_000 / 30, false);
        assert_eq!(
            rates.rate(),
            before,
            "the same frame by the other transport"
        );
        rates.push(0, true);
        assert_eq!(rates.rate(), None);
        for index in 1..10_000 {
            rates.push(index, true);
        }
        assert!(rates.0.len() <= MOST);
    }
}
