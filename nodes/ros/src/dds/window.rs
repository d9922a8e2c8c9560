//! The window of a reliable writer: which samples its readers may still ask for. rustdds' own window only ever closes;
//! this one moves on, and leaves behind the readers that do not keep up ([`super::wire`] tells how).

use super::qos::RELIABLE_WINDOW;

/// A window moves on by this part of it at once, so that readers keep at least as much.
const STEPS: usize = 4;
/// It moves on after this many bytes, too: twice this is kept of large samples \[byte\].
const STEP_BYTES: usize = 16 << 20;

/// What is known of the samples of a reliable writer.
#[derive(Debug)]
pub(super) struct Window {
    step: i64,
    last: i64,
    /// Every reader has everything up to this.
    acknowledged: i64,
    /// Where it moved on last, and the time before: what is behind that is given up next.
    marks: [i64; 2],
    bytes: usize,
}

/// Everything up to `number` is given up, and `dropped` samples of it before some reader had them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Release {
    pub(super) number: i64,
    pub(super) dropped: u64,
}

impl Window {
    /// For a writer of this depth, which rustdds gives a window of at least [`RELIABLE_WINDOW`] samples.
    pub(super) fn new(depth: usize) -> Self {
        // beyond this, no machine has the memory
        let step = i32::try_from(RELIABLE_WINDOW.max(depth) / STEPS).unwrap_or(i32::MAX);
        Self {
            step: step.into(),
            last: 0,
            acknowledged: 0,
            marks: [0; 2],
            bytes: 0,
        }
    }

    /// The number of the last sample.
    pub(super) const fn last(&self) -> i64 {
        self.last
    }

    /// Every reader has every sample.
    pub(super) const fn all_acknowledged(&mut self) {
        self.acknowledged = self.last;
    }

    /// A sample was written; what is given up for it.
    pub(super) fn wrote(&mut self, number: i64, len: usize) -> Option<Release> {
        self.last = number;
        self.bytes += len;
        let is_step = self.last - self.marks[1] >= self.step || self.bytes >= STEP_BYTES;
        is_step.then(|| self.move_on())
    }

    /// Gives up what is oldest.
    pub(super) fn move_on(&mut self) -> Release {
        let number = self.marks[0];
        let dropped = u64::try_from(number - self.acknowledged).unwrap_or(0);
        self.acknowledged = self.acknowledged.max(number);
        self.marks = [self.marks[1], self.last];
        self.bytes = 0;
        Release { number, dropped }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readers_that_keep_up_lose_nothing_and_the_others_the_oldest() {
        let mut window = Window::new(10);
        let mut dropped = 0;
        for number in 1..=2000 {
            if number < 1000 {
                window.all_acknowledged();
            }
            if let Some(release) = window.wrote(number, 100) {
                assert!(number - release.number < RELIABLE_WINDOW as i64, "too late");
                assert!(number - release.number >= 128, "{release:?} at {number}");
                dropped += release.dropped;
            }
            if number == 1100 {
                assert_eq!(dropped, 0);
            }
        }
        let behind = window.marks[0] as u64 - 999;
        assert!(dropped > 600 && dropped <= behind, "{dropped} of {behind}");
    }

    #[test]
    fn large_samples_move_it_sooner() {
        let mut window = Window::new(10);
        let released = (1..=100).filter_map(|number| window.wrote(number, 1 << 20));
        let numbers: Vec<i64> = released.map(|release| release.number).collect();
        assert_eq!(numbers, [0, 0, 16, 32, 48, 64]);
    }
}
