//! Options of an episode.

use crate::variety::Variety;

/// Options of an [`Episode`](crate::Episode).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpisodeOptions {
    /// Number of frames, at 5 Hz.
    pub frames: usize,
    /// Whether to render object and gripper masks.
    pub masks: bool,
    /// Share of failed episodes, 0 to 1. If it is not 0, every episode has one task.
    pub failures: f64,
    /// Variation between episodes.
    pub variety: Variety,
}

impl Default for EpisodeOptions {
    fn default() -> Self {
        Self {
            frames: 50,
            masks: false,
            failures: 0.0,
            variety: Variety::default(),
        }
    }
}
