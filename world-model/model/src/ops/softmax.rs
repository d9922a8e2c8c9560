//! The weights of an attention.

use super::exponential::exp;
use super::reduction::{largest, replace_and_sum};
use super::vectorised::vectorised;

vectorised! {
    /// Softmax, in place, of the first `count` values of every row of `pitch`.
    pub(crate) fn softmax_rows(scores: &mut [f32], pitch: usize, count: usize) {
        for row in scores.chunks_exact_mut(pitch) {
            let row = &mut row[..count];
            let most = largest(row);
            let inverse = 1.0 / replace_and_sum(row, |score| exp(score - most));
            for weight in row {
                *weight *= inverse;
            }
        }
    }
}
