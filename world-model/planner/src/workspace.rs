//! The region of the end effector.

use serde::{Deserialize, Serialize};

/// A box for planned motion, along the axes of the actions' frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Workspace {
    /// One axis per searched value that moves along it.
    pub axes: Vec<WorkspaceAxis>,
}

/// An axis of the box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorkspaceAxis {
    /// Index of the searched value that moves along it.
    pub coordinate: usize,
    /// Motion of a model step for a value of 1 \[m\].
    pub metres: f64,
    /// Position at the start of the plan \[m\].
    pub position: f64,
    /// Least and greatest position \[m\].
    pub range: (f64, f64),
}

impl WorkspaceAxis {
    /// The value nearest to `value` that keeps the position within the range, and the resulting position. From outside,
    /// only motion towards the range is allowed.
    pub(crate) fn keep(&self, position: f64, value: f32) -> (f32, f64) {
        let (low, high) = self.range;
        let next = position + f64::from(value) * self.metres;
        let kept = next.clamp(low.min(position), high.max(position));
        if kept == next || self.metres == 0.0 {
            return (value, next);
        }
        (((kept - position) / self.metres) as f32, kept)
    }

    /// Distance of `position` beyond the range narrowed by `margin` on both sides \[m\].
    pub(crate) fn beyond(&self, position: f64, margin: f64) -> f64 {
        let (low, high) = self.range;
        (low + margin - position)
            .max(position - (high - margin))
            .max(0.0)
    }
}
