//! Layer normalisation for inference.

use rayon::prelude::*;

use super::reduction::sum_of;
use super::vectorised::vectorised;

/// Rows that one task handles.
const ROWS: usize = 32;

/// Normalises every row of `x` (rows, width) in place to mean 0 and variance 1 (`eps` is added to
/// it), then scales and shifts each column by `scale` and `shift` (width).
///
/// # Panics
/// If `x` is not whole rows, or the widths differ.
pub fn layer_norm(x: &mut [f32], (scale, shift): (&[f32], &[f32]), eps: f32) {
    let width = scale.len();
    assert!(
        width > 0 && shift.len() == width && x.len().is_multiple_of(width),
        "rows, scale and shift of a normalisation"
    );
    x.par_chunks_mut(ROWS * width)
        .for_each(|rows| normalise_rows(rows, scale, shift, eps));
}

vectorised! {
    fn normalise_rows(rows: &mut [f32], scale: &[f32], shift: &[f32], eps: f32) {
        let width = scale.len();
        for row in rows.chunks_exact_mut(width) {
            let mean = sum_of(row, |x| x) / width as f32;
            let variance = sum_of(row, |x| (x - mean) * (x - mean)) / width as f32;
            let factor = 1.0 / (variance + eps).sqrt();
            for ((x, scale), shift) in row.iter_mut().zip(scale).zip(shift) {
                *x = ((*x - mean) * factor).mul_add(*scale, *shift);
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
        let mut x: Vec<f32> = (0..40 * width)
            .map(|i| ((i * 31) % 101) as f32 + 7.0)
            .collect();
        let (scale, shift) = (vec![2.0; width], vec![0.5; width]);
        layer_norm(&mut x, (&scale, &shift), 0.0);
        for row in x.chunks_exact(width) {
            let normed = row.iter().map(|x| (x - 0.5) / 2.0);
            let mean = normed.clone().sum::<f32>() / width as f32;
            let variance = normed.map(|x| x * x).sum::<f32>() / width as f32;
            assert!(mean.abs() < 1e-5 && (variance - 1.0).abs() < 1e-4);
        }
    }
}
