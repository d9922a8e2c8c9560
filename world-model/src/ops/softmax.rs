//! The weights of an attention.

use super::exponential::exp;
use super::simd::LANES;
use super::vectorised::vectorised;

vectorised! {
    /// Softmax, in place, of the first `count` values of every row of `pitch`.
    pub(crate) fn softmax_rows(scores: &mut [f32], pitch: usize, count: usize) {
        for row in scores.chunks_exact_mut(pitch) {
            let row = &mut row[..count];
            let mut most = [f32::NEG_INFINITY; LANES];
            let (chunks, rest) = row.as_chunks::<LANES>();
            for chunk in chunks {
                for (most, value) in most.iter_mut().zip(chunk) {
                    *most = if *value > *most { *value } else { *most };
                }
            }
            let most = most.iter().chain(rest).copied().fold(f32::NEG_INFINITY, f32::max);
            let mut sums = [0.0_f32; LANES];
            let (chunks, rest) = row.as_chunks_mut::<LANES>();
            for chunk in chunks {
                for (sum, value) in sums.iter_mut().zip(chunk) {
                    *value = exp(*value - most);
                    *sum += *value;
                }
            }
            let mut sum: f32 = sums.iter().sum();
            for value in rest {
                *value = exp(*value - most);
                sum += *value;
            }
            let inverse = 1.0 / sum;
            for value in row {
                *value *= inverse;
            }
        }
    }
}
