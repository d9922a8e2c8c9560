//! Layer normalisation for inference.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::reduction::sum_of;
use super::uncleared::uncleared;
use super::vectorised::vectorised;

/// Rows that one task handles.
const ROWS: usize = 32;

/// Every row of `x` (rows, width) with mean 0 and variance 1 (`eps` is added to it), each column then scaled and shifted by
/// `scale` and `shift` (width): (rows, width).
///
/// # Panics
/// If `x` is not whole rows, or the widths differ.
pub fn layer_norm(x: &[f32], (scale, shift): (&[f32], &[f32]), eps: f32) -> Vec<f32> {
    let width = scale.len();
    assert!(
        width > 0 && shift.len() == width && x.len().is_multiple_of(width),
        "rows, scale and shift of a normalisation"
    );
    let write = |out: &mut [MaybeUninit<f32>]| {
        out.par_chunks_mut(ROWS * width)
            .zip(x.par_chunks(ROWS * width))
            .for_each(|(out, x)| normalise_rows(x, scale, shift, eps, out));
    };
    // SAFETY: the chunks are whole rows and cover all values, and each value of a row is written.
    unsafe { uncleared(x.len(), write) }
}

vectorised! {
    /// Writes every value of `out`, which is as long as `rows`.
    fn normalise_rows(rows: &[f32], scale: &[f32], shift: &[f32], eps: f32, out: &mut [MaybeUninit<f32>]) {
        let width = scale.len();
        for (row, out) in rows.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
            let mean = sum_of(row, |x| x) / width as f32;
            let variance = sum_of(row, |x| (x - mean) * (x - mean)) / width as f32;
            let factor = 1.0 / (variance + eps).sqrt();
            for (((x, out), scale), shift) in row.iter().zip(out).zip(scale).zip(shift) {
                out.write(((*x - mean) * factor).mul_add(*scale, *shift));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_get_mean_zero_and_variance_one_before_the_affine_map() {
        let width = 37;
        let x: Vec<f32> = (0..40 * width)
            .map(|i| ((i * 31) % 101) as f32 + 7.0)
            .collect();
        let (scale, shift) = (vec![2.0; width], vec![0.5; width]);
        let out = layer_norm(&x, (&scale, &shift), 0.0);
        assert_eq!(out.len(), x.len());
        for row in out.chunks_exact(width) {
            let normed = row.iter().map(|x| (x - 0.5) / 2.0);
            let mean = normed.clone().sum::<f32>() / width as f32;
            let variance = normed.map(|x| x * x).sum::<f32>() / width as f32;
            assert!(mean.abs() < 1e-5 && (variance - 1.0).abs() < 1e-4);
        }
    }
}
