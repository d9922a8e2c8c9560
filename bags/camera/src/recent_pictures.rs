//! Pictures that are published again.

use std::collections::VecDeque;

/// Pictures that are remembered: a driver that has stopped may publish its last few buffers in turn, usually four.
const REMEMBERED: usize = 4;

/// The last few pictures of a camera, by their [fingerprints](crate::camera_frame::CameraFrame::fingerprint).
#[derive(Clone, Debug, Default)]
pub struct RecentPictures(VecDeque<u64>);

impl RecentPictures {
    /// Takes the next picture; whether it is new, and not one of the last few.
    pub fn insert(&mut self, fingerprint: u64) -> bool {
        if self.0.contains(&fingerprint) {
            return false;
        }
        if self.0.len() == REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back(fingerprint);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_in_turn_are_not_new() {
        let mut recent = RecentPictures::default();
        let is_new = [1, 2, 3, 4, 1, 2, 3, 4, 5, 2, 1, 3].map(|picture| recent.insert(picture));
        let mut expected = [true; 12];
        // Picture 5 displaces picture 1, and then picture 1 displaces picture 2.
        for repeated in [4, 5, 6, 7, 9, 11] {
            expected[repeated] = false;
        }
        assert_eq!(is_new, expected);
    }
}
