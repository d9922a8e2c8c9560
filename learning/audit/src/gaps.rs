//! Times between successive messages of a topic.

use std::collections::BTreeMap;

/// Resolution of the histogram: classes 3.5 % wide, in bounded memory.
const CLASSES_PER_OCTAVE: f64 = 20.0;
/// Gap that means a missing message, as in data sets; stamps jitter by less \[periods\].
const MISSING_PERIODS: f64 = 1.75;
/// Gap that is a pause instead, if it also lasts [`PAUSE_S`] \[periods\].
const PAUSE_PERIODS: f64 = 10.0;
/// Minimum duration of a pause \[s\].
const PAUSE_S: f64 = 1.0;

/// Histogram of positive times between successive messages.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Gaps {
    /// Number and sum \[s\] of the gaps, by class.
    classes: BTreeMap<i32, (u64, f64)>,
    count: u64,
}

impl Gaps {
    /// Adds a gap \[ns\]; ignores gaps that are not positive.
    pub fn push(&mut self, gap_ns: i64) {
        if gap_ns <= 0 {
            return;
        }
        let seconds = gap_ns as f64 / 1e9;
        // Fits: from -600 to 700.
        let class = (seconds.log2() * CLASSES_PER_OCTAVE).floor() as i32;
        let (count, sum) = self.classes.entry(class).or_default();
        *count += 1;
        *sum += seconds;
        self.count += 1;
    }

    /// Adds the gaps of another part of the recording.
    pub(crate) fn append(&mut self, other: &Self) {
        for (class, (count, sum)) in &other.classes {
            let (own_count, own_sum) = self.classes.entry(*class).or_default();
            *own_count += count;
            *own_sum += sum;
        }
        self.count += other.count;
    }

    /// The median \[s\], to within 3.5 %; `None` for fewer than two gaps.
    pub fn median_s(&self) -> Option<f64> {
        if self.count < 2 {
            return None;
        }
        let mut before = 0;
        for (count, sum) in self.classes.values() {
            before += count;
            if before * 2 > self.count {
                return Some(sum / *count as f64);
            }
        }
        None
    }

    /// Number of missing messages, and the longest gap \[s\]. Pauses do not count.
    pub fn missing(&self) -> (u64, f64) {
        let Some(period_s) = self.median_s() else {
            return (0, 0.0);
        };
        let (mut missing, mut longest_s) = (0, 0.0_f64);
        for (count, sum) in self.classes.values() {
            let gap_s = sum / *count as f64;
            longest_s = longest_s.max(gap_s);
            let periods = gap_s / period_s;
            let is_pause = periods >= PAUSE_PERIODS && gap_s >= PAUSE_S;
            if periods >= MISSING_PERIODS && !is_pause {
                // Fits: at most 9, or less than a second.
                missing += count * (periods.round() as u64).saturating_sub(1);
            }
        }
        (missing, longest_s)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn of_milliseconds(gaps: impl IntoIterator<Item = i64>) -> Gaps {
        let mut all = Gaps::default();
        gaps.into_iter().for_each(|gap| all.push(gap * 1_000_000));
        all
    }

    #[test]
    fn jitter_is_not_a_missing_message() {
        // As of a real arm: 10 Hz with 31 ms of jitter.
        let jitter = (0..200).map(|index| 100 + (index * 37 % 63) - 31);
        let gaps = of_milliseconds(jitter);
        assert!((gaps.median_s().unwrap() - 0.1).abs() < 0.005);
        assert_eq!(gaps.missing().0, 0);
    }

    #[test]
    fn missing_messages_are_counted_and_pauses_are_not() {
        let mut gaps = of_milliseconds([200; 50]);
        gaps.push(400_000_000);
        gaps.push(800_000_000);
        assert_eq!(gaps.missing().0, 1 + 3);
        gaps.push(60_000_000_000);
        let (missing, longest_s) = gaps.missing();
        assert_eq!((missing, gaps.count), (4, 53));
        assert!((longest_s - 60.0).abs() < 1e-6);
    }

    #[test]
    fn gaps_that_are_not_positive_are_ignored() {
        let gaps = of_milliseconds([0, -5, 100]);
        assert_eq!(
            (gaps.count, gaps.median_s(), gaps.missing()),
            (1, None, (0, 0.0))
        );
        assert!(
            of_milliseconds([i64::MAX / 1_000_000; 3])
                .median_s()
                .is_some()
        );
    }
}
