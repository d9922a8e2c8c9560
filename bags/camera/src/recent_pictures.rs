//! Detection of repeated pictures.

use std::collections::VecDeque;

/// Number of remembered pictures: a stopped driver may publish its last buffers, usually four, in turn.
const REMEMBERED: usize = 4;

/// The last pictures of a camera, by their [fingerprints](crate::camera_frame::CameraFrame::fingerprint).
#[derive(Clone, Debug, Default)]
pub struct RecentPictures(VecDeque<u64>);

impl RecentPictures {
    /// Adds the next picture; false if it repeats one of the last.
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
    fn pictures_published_in_turn_are_not_new() {
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
