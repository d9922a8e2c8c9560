//! The choice of frames shown to a judge.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::judges::{Error, Result};

/// Most pictures in one question; more than any server accepts.
pub const MAX_FRAMES: usize = 256;

/// Number of frames shown, by part of the video. The default is the paper's: 16, "with 10 sampled uniformly throughout
/// the video and 6 sampled uniformly from the second half", because the end shows success best.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameChoice {
    /// Spread over the whole video, first and last frame included.
    pub whole: usize,
    /// Spread over the second half, first and last frame included.
    pub tail: usize,
}

impl Default for FrameChoice {
    fn default() -> Self {
        Self { whole: 10, tail: 6 }
    }
}

impl FrameChoice {
    /// Checks the numbers.
    ///
    /// # Errors
    /// If both are 0, or their sum exceeds [`MAX_FRAMES`].
    pub fn check(self) -> Result<()> {
        let total = self.whole.saturating_add(self.tail);
        if (1..=MAX_FRAMES).contains(&total) {
            return Ok(());
        }
        Err(Error::Setting {
            owner: "frames".to_owned(),
            setting: "whole + tail",
            found: total.to_string(),
            expected: "1 to 256",
        })
    }

    /// Indices of `whole + tail` distinct frames of a video of `n`, ascending; all `n` if there are no more.
    ///
    /// Of `k` frames over `first..=last`, frame `i` is `first + i * (last - first) / (k - 1)`, rounded half up; a
    /// single frame is the last. The second half starts at `n / 2`, rounded down. The paper does not define frames that
    /// both parts choose (the last always is): here the tail takes the nearest free frame, the later of two.
    #[must_use]
    pub fn indices(self, n: usize) -> Vec<usize> {
        let total = self.whole.saturating_add(self.tail);
        if n <= total {
            return (0..n).collect();
        }
        let last = n - 1;
        let mut chosen: BTreeSet<usize> = spread(self.whole, 0, last).collect();
        for wanted in spread(self.tail, n / 2, last) {
            // Terminates, since fewer than n are used.
            let near = (0..n).find_map(|distance| {
                let later = wanted.checked_add(distance).filter(|i| *i <= last);
                let earlier = wanted.checked_sub(distance);
                let free = |i: &usize| !chosen.contains(i);
                later.filter(free).or_else(|| earlier.filter(free))
            });
            chosen.extend(near);
        }
        chosen.into_iter().collect()
    }
}

/// `count` numbers over `first..=last`.
fn spread(count: usize, first: usize, last: usize) -> impl Iterator<Item = usize> {
    // The product needs u128.
    let (gaps, length) = (count.saturating_sub(1) as u128, (last - first) as u128);
    (0..count as u128).map(move |i| {
        let steps = if gaps == 0 {
            length
        } else {
            (2 * i * length + gaps) / (2 * gaps)
        };
        // At most `length`, which came from a usize.
        first + steps as usize
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn sixteen_of_fifty_frames_match_the_paper() {
        // Whole: 0 5 11 16 22 27 33 38 44 49. Tail: 25 30 35 39 44 49, of which 44 and 49 are used already.
        assert_eq!(
            FrameChoice::default().indices(50),
            [0, 5, 11, 16, 22, 25, 27, 30, 33, 35, 38, 39, 44, 45, 48, 49]
        );
    }

    #[test]
    fn short_videos_are_shown_whole() {
        for n in 0..=16 {
            let all: Vec<usize> = (0..n).collect();
            assert_eq!(FrameChoice::default().indices(n), all);
        }
        assert_eq!(FrameChoice::default().indices(17).len(), 16);
    }

    #[test]
    fn a_single_frame_is_the_last() {
        assert_eq!(FrameChoice { whole: 1, tail: 0 }.indices(9), [8]);
        assert_eq!(FrameChoice { whole: 0, tail: 1 }.indices(9), [8]);
        assert_eq!(FrameChoice { whole: 1, tail: 1 }.indices(9), [7, 8]);
        assert!(FrameChoice { whole: 0, tail: 0 }.indices(9).is_empty());
    }

    #[test]
    fn invalid_numbers_are_rejected() {
        for (whole, tail) in [(0, 0), (250, 7), (usize::MAX, 1)] {
            let error = FrameChoice { whole, tail }.check().unwrap_err().to_string();
            assert!(error.contains("1 to 256"), "{error}");
        }
        FrameChoice::default().check().unwrap();
    }

    proptest! {
        #[test]
        fn indices_are_sorted_in_range_and_complete(whole in 0_usize..40, tail in 0_usize..40, n in 0_usize..300) {
            let indices = FrameChoice { whole, tail }.indices(n);
            prop_assert_eq!(indices.len(), n.min(whole + tail));
            prop_assert!(indices.iter().all(|i| *i < n));
            prop_assert!(indices.is_sorted_by(|a, b| a < b));
            if whole > 1 && n > 0 {
                prop_assert_eq!((indices[0], indices[indices.len() - 1]), (0, n - 1));
            }
        }

        #[test]
        fn indices_exist_for_any_length(n in 17..=usize::MAX) {
            let indices = FrameChoice::default().indices(n);
            prop_assert_eq!(indices.len(), 16);
            prop_assert!(indices.is_sorted_by(|a, b| a < b) && indices[15] == n - 1);
            // Ten of the whole have five in the second half, plus six of the tail.
            prop_assert!(n < 40 || indices.iter().filter(|i| **i >= n / 2).count() >= 11);
        }
    }
}
