//! The last observed frames.

use std::{collections::VecDeque, sync::Arc};

use wm_msgs::std_msgs::Header;

use super::Reception;

/// Number of frames over which the camera's period is measured.
const RECENT: usize = 5;

/// One observed frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// When it was captured \[ns\].
    pub stamp_ns: i64,
    /// The camera's optical frame.
    pub frame_id: Arc<str>,
    /// Its normalised latent, row-major, channels last.
    pub values: Arc<[f32]>,
    /// Whether the camera had stopped: no node may act on it.
    pub is_frozen: bool,
    /// When it arrived, and from which publisher.
    pub reception: Reception,
}

/// A latent of the history's space that has not been taken yet.
#[derive(Clone, Debug)]
pub struct Observation<'a> {
    /// Of the camera's frame.
    pub header: &'a Header,
    /// Normalised, row-major, channels last.
    pub values: Arc<[f32]>,
    /// The epoch of its publisher.
    pub epoch: u64,
    /// Whether the camera has stopped.
    pub is_frozen: bool,
}

/// Frames in the order of their stamps, as many as fit a span of time.
#[derive(Clone, Debug)]
pub(super) struct Frames {
    frames: VecDeque<Frame>,
    span_ns: i64,
    /// Frames that stay however old they are: two for the camera's period, and a whole context while the next one is
    /// still coming from a slow encoder.
    least: usize,
}

impl Frames {
    pub(super) fn new(span_ns: i64, context_frames: usize) -> Self {
        Self {
            frames: VecDeque::new(),
            span_ns,
            least: context_frames.saturating_mul(2).max(3) - 1,
        }
    }

    pub(super) fn newest(&self) -> Option<&Frame> {
        self.frames.back()
    }

    /// The newest first.
    pub(super) fn newest_first(&self) -> impl Iterator<Item = &Frame> {
        self.frames.iter().rev()
    }

    /// Adds a frame later than all others, forgets those beyond the span.
    pub(super) fn push(&mut self, frame: Frame) {
        let oldest_ns = frame.stamp_ns.saturating_sub(self.span_ns);
        self.frames.push_back(frame);
        while self.frames.len() > self.least
            && (self.frames.front()).is_some_and(|frame| frame.stamp_ns < oldest_ns)
        {
            self.frames.pop_front();
        }
    }

    /// The frame nearest to a stamp.
    pub(super) fn near(&self, stamp_ns: i64, tolerance_ns: i64) -> Option<&Frame> {
        let distance = |frame: &&Frame| (frame.stamp_ns - stamp_ns).abs();
        self.frames
            .iter()
            .min_by_key(distance)
            .filter(|frame| distance(frame) <= tolerance_ns)
    }

    pub(super) fn reach_back_to(&self, stamp_ns: i64) -> bool {
        self.frames
            .front()
            .is_some_and(|frame| frame.stamp_ns <= stamp_ns)
    }

    /// The shortest of the last few gaps between frames, so that lost frames do not count \[ns\].
    pub(super) fn period_ns(&self) -> Option<i64> {
        let newest = self.frames.iter().rev().take(RECENT);
        let before = self.frames.iter().rev().skip(1);
        let gaps = newest
            .zip(before)
            .map(|(later, earlier)| later.stamp_ns - earlier.stamp_ns);
        gaps.min()
    }

    pub(super) fn clear(&mut self) {
        self.frames.clear();
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.frames.len()
    }
}
