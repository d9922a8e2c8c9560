//! Which frames see which, and where they stand in time.

use crate::Result;
use crate::ops::{AttentionPattern, Axis, RotaryTable};

/// Positions of frames in the window, and which frames each attends to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TemporalPattern {
    positions: Vec<usize>,
    /// Row by row: does the query frame see the key frame?
    visible: Vec<bool>,
}

impl TemporalPattern {
    /// `frames` frames in order, each of which sees itself and all before it.
    pub fn causal(frames: usize) -> Self {
        Self::new((0..frames).collect(), |query, key| key <= query)
    }

    /// For training as the model is used: the first `frames - 1` clean frames in order, each of
    /// which sees itself and those before it, then the frames from `history` on once more, noisy,
    /// each of which sees the clean frames before it and itself.
    pub fn teacher_forcing(frames: usize, history: usize) -> Self {
        let clean = frames.saturating_sub(1);
        let positions = (0..clean).chain(history..frames).collect();
        Self::new(positions, move |query, key| {
            if query < clean {
                key <= query
            } else {
                key == query || (key < clean && key < history + query - clean)
            }
        })
    }

    /// Frames at `positions`; `visible(query, key)` tells who sees whom.
    pub fn new(positions: Vec<usize>, visible: impl Fn(usize, usize) -> bool) -> Self {
        let n = positions.len();
        let visible = (0..n * n).map(|i| visible(i / n, i % n)).collect();
        Self { positions, visible }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    pub(super) fn attention(&self, heads: usize, head_dim: usize) -> Result<AttentionPattern> {
        let n = self.len();
        let rotary = RotaryTable::sequence(&self.positions, head_dim);
        let visible =
            |query: usize, key: usize| self.visible.get(query * n + key).copied().unwrap_or(false);
        Ok(AttentionPattern::new(Axis::Time, heads, rotary, visible)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noisy_frame_sees_the_clean_ones_before_it_and_itself() {
        let pattern = TemporalPattern::teacher_forcing(4, 2);
        assert_eq!(pattern.positions, [0, 1, 2, 2, 3]);
        let seen: Vec<Vec<usize>> = pattern
            .visible
            .chunks(5)
            .map(|row| (0..5).filter(|i| row[*i]).collect())
            .collect();
        assert_eq!(
            seen,
            [
                vec![0],
                vec![0, 1],
                vec![0, 1, 2],
                vec![0, 1, 3],
                vec![0, 1, 2, 4]
            ]
        );
    }
}
