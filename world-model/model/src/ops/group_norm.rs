//! Group normalisation.

mod differentiable;

use rayon::prelude::*;

pub use differentiable::differentiable_group_norm;

use super::exponential::sigmoid;
use super::vectorised::vectorised;

/// Values that one task handles, about.
const CHUNK: usize = 32 * 1024;

/// Pixels that are summed in f32 before the sum goes to f64: few enough for nothing to be rounded away.
const PIXELS: usize = 32;

/// What follows the normalisation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// Negative values become zero.
    Relu,
    /// x times the logistic function of x.
    Silu,
}

/// What normalises the channels of one image: a factor and an offset of each, and what follows.
#[derive(Clone, Debug)]
pub struct Normalisation {
    factors: Vec<f32>,
    offsets: Vec<f32>,
    activation: Activation,
}

impl Normalisation {
    /// Normalises pixels in place.
    fn apply(&self, pixels: &mut [f32]) {
        apply(pixels, &self.factors, &self.offsets, self.activation);
    }

    /// Writes the normalised pixels of `from` to `to`, which is as long.
    pub(crate) fn apply_to(&self, from: &[f32], to: &mut [f32]) {
        to.copy_from_slice(from);
        self.apply(to);
    }
}

/// Normalises `x` (N, pixels, channels) in place over each group of neighbouring channels of an
/// image, then scales and shifts each channel, and applies `activation`. On all threads of the pool; the result does
/// not depend on how many there are.
///
/// Variance is the biased one, as in PyTorch. Sums are taken in f64.
pub fn group_norm(
    x: &mut [f32],
    pixels: usize,
    groups: usize,
    affine: (&[f32], &[f32]),
    eps: f64,
    activation: Activation,
) {
    let channels = affine.0.len();
    if channels < groups.max(1) || pixels == 0 {
        return;
    }
    let chunk = (CHUNK / channels).clamp(1, pixels) * channels;
    let all = group_normalisations(x, pixels, groups, affine, eps, activation);
    let images = x.par_chunks_exact_mut(pixels * channels);
    images.zip(all).for_each(|(image, normalisation)| {
        image
            .par_chunks_mut(chunk)
            .for_each(|pixels| normalisation.apply(pixels));
    });
}

/// What [`group_norm`] does to each image of `x`, for a convolution that does it to its input.
pub fn group_normalisations(
    x: &[f32],
    pixels: usize,
    groups: usize,
    (scale, shift): (&[f32], &[f32]),
    eps: f64,
    activation: Activation,
) -> Vec<Normalisation> {
    let channels = scale.len();
    let size = channels / groups.max(1);
    if size == 0 || pixels == 0 {
        return Vec::new();
    }
    let chunk = (CHUNK / channels).clamp(1, pixels) * channels;
    let images = x.par_chunks_exact(pixels * channels);
    let of_image = images.map(|image| {
        let parts: Vec<Vec<f64>> = image
            .par_chunks(chunk)
            .map(|pixels| {
                let mut sums = vec![0.0; 2 * channels];
                channel_sums(pixels, &mut sums);
                sums
            })
            .collect();
        let mut sums = vec![(0f64, 0f64); groups];
        for part in parts {
            for (pair, group) in part.chunks_exact(2 * size).zip(&mut sums) {
                for pair in pair.chunks_exact(2) {
                    let &[sum, square] = pair else { continue };
                    group.0 += sum;
                    group.1 += square;
                }
            }
        }
        let count = (pixels * size) as f64;
        let (mut factors, mut offsets) = (vec![0.0; channels], vec![0.0; channels]);
        let of_channel = factors.iter_mut().zip(&mut offsets);
        for (c, ((factor, offset), (scale, shift))) in
            of_channel.zip(scale.iter().zip(shift)).enumerate()
        {
            let Some((sum, squares)) = sums.get(c / size) else {
                continue;
            };
            let mean = sum / count;
            let variance = (squares / count - mean * mean).max(0.0);
            let wide = f64::from(*scale) / (variance + eps).sqrt();
            *factor = wide as f32;
            *offset = (f64::from(*shift) - mean * wide) as f32;
        }
        Normalisation {
            factors,
            offsets,
            activation,
        }
    });
    of_image.collect()
}

vectorised! {
    /// The sum and the sum of squares of each channel of `x` (pixels, channels), to `sums` (channels, 2).
    fn channel_sums(x: &[f32], sums: &mut [f64]) {
        let channels = sums.len() / 2;
        let (mut plain, mut squares) = (vec![0f32; channels], vec![0f32; channels]);
        for pixels in x.chunks(PIXELS * channels) {
            plain.fill(0.0);
            squares.fill(0.0);
            for pixel in pixels.chunks_exact(channels) {
                for ((v, sum), square) in pixel.iter().zip(&mut plain).zip(&mut squares) {
                    *sum += v;
                    *square = v.mul_add(*v, *square);
                }
            }
            for ((pair, sum), square) in sums.chunks_exact_mut(2).zip(&plain).zip(&squares) {
                if let [total, total_square] = pair {
                    *total += f64::from(*sum);
                    *total_square += f64::from(*square);
                }
            }
        }
    }
}

vectorised! {
    fn apply(x: &mut [f32], factors: &[f32], offsets: &[f32], activation: Activation) {
        for pixel in x.chunks_exact_mut(factors.len()) {
            for ((v, factor), offset) in pixel.iter_mut().zip(factors).zip(offsets) {
                *v = v.mul_add(*factor, *offset);
            }
            match activation {
                Activation::None => {}
                Activation::Relu => pixel.iter_mut().for_each(|v| *v = v.max(0.0)),
                Activation::Silu => pixel.iter_mut().for_each(|v| *v *= sigmoid(*v)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_group_gets_mean_zero_and_variance_one() {
        for pixels in [7, 9001] {
            check_moments(pixels, 8, 4);
        }
    }

    fn check_moments(pixels: usize, channels: usize, groups: usize) {
        let mut x: Vec<f32> = (0..2 * pixels * channels)
            .map(|i| ((i * 37 % 101) as f32) * 0.3 - 4.0)
            .collect();
        let (scale, shift) = (vec![2.0; channels], vec![0.5; channels]);
        group_norm(
            &mut x,
            pixels,
            groups,
            (&scale, &shift),
            0.0,
            Activation::None,
        );
        for image in x.chunks_exact(pixels * channels) {
            for g in 0..groups {
                let values: Vec<f64> = image
                    .chunks_exact(channels)
                    .flat_map(|p| p[g * 2..g * 2 + 2].to_vec())
                    .map(f64::from)
                    .collect();
                let n = values.len() as f64;
                let mean = values.iter().sum::<f64>() / n;
                let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
                assert!((mean - 0.5).abs() < 1e-5, "mean {mean}");
                assert!((variance - 4.0).abs() < 1e-3, "variance {variance}");
            }
        }
    }

    #[test]
    fn relu_removes_what_is_negative() {
        let mut x = vec![-1.0, 1.0, -3.0, 3.0];
        group_norm(
            &mut x,
            2,
            1,
            (&[1.0, 1.0], &[0.0, 0.0]),
            1e-5,
            Activation::Relu,
        );
        assert_eq!(x[0], 0.0);
        assert!(x[3] > 1.0);
    }
}
