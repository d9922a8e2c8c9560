//! Group normalisation.

use rayon::prelude::*;

/// Normalises `x` (N, pixels, channels) in place over each group of neighbouring channels of an
/// image, then scales and shifts each channel, and makes negative values zero if `relu` is set.
///
/// Variance is the biased one, as in PyTorch. Sums are taken in f64.
pub fn group_norm(
    x: &mut [f32],
    pixels: usize,
    groups: usize,
    (scale, shift): (&[f32], &[f32]),
    eps: f64,
    relu: bool,
) {
    let channels = scale.len();
    let size = channels / groups.max(1);
    if size == 0 || pixels == 0 {
        return;
    }
    x.par_chunks_exact_mut(pixels * channels).for_each(|image| {
        let mut sums = vec![(0f64, 0f64); groups];
        for pixel in image.chunks_exact(channels) {
            for (group, sum) in pixel.chunks_exact(size).zip(&mut sums) {
                for v in group {
                    sum.0 += f64::from(*v);
                    sum.1 += f64::from(*v) * f64::from(*v);
                }
            }
        }
        let count = (pixels * size) as f64;
        let mut factors = Vec::with_capacity(channels);
        for (c, (scale, shift)) in scale.iter().zip(shift).enumerate() {
            let Some((sum, squares)) = sums.get(c / size) else {
                continue;
            };
            let mean = sum / count;
            let variance = (squares / count - mean * mean).max(0.0);
            let factor = f64::from(*scale) / (variance + eps).sqrt();
            factors.push((factor as f32, (f64::from(*shift) - mean * factor) as f32));
        }
        for pixel in image.chunks_exact_mut(channels) {
            for (v, (factor, offset)) in pixel.iter_mut().zip(&factors) {
                *v = *v * factor + offset;
                if relu {
                    *v = v.max(0.0);
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_group_gets_mean_zero_and_variance_one() {
        let (pixels, channels, groups) = (7, 8, 4);
        let mut x: Vec<f32> = (0..2 * pixels * channels)
            .map(|i| ((i * 37 % 101) as f32) * 0.3 - 4.0)
            .collect();
        let (scale, shift) = (vec![2.0; channels], vec![0.5; channels]);
        group_norm(&mut x, pixels, groups, (&scale, &shift), 0.0, false);
        for image in x.chunks_exact(pixels * channels) {
            for g in 0..groups {
                let values: Vec<f32> = image
                    .chunks_exact(channels)
                    .flat_map(|p| p[g * 2..g * 2 + 2].to_vec())
                    .collect();
                let n = values.len() as f32;
                let mean = values.iter().sum::<f32>() / n;
                let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n;
                assert!((mean - 0.5).abs() < 1e-5, "mean {mean}");
                assert!((variance - 4.0).abs() < 1e-3, "variance {variance}");
            }
        }
    }

    #[test]
    fn relu_removes_what_is_negative() {
        let mut x = vec![-1.0, 1.0, -3.0, 3.0];
        group_norm(&mut x, 2, 1, (&[1.0, 1.0], &[0.0, 0.0]), 1e-5, true);
        assert_eq!(x[0], 0.0);
        assert!(x[3] > 1.0);
    }
}
