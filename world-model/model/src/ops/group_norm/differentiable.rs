//! A group normalisation that propagates gradients.

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::{Activation, PIXELS, channel_sums, group_norm};
use crate::ops::exponential::sigmoid;
use crate::ops::host::{host, slice};
use crate::ops::vectorised::vectorised;

/// As [`group_norm`], of `x` (N, H, W, C) with a scale and a shift (C) each, f32 on the CPU; propagates gradients to all
/// three.
///
/// # Errors
/// If the shapes do not fit, a tensor is not f32 on the CPU, or `activation` is ReLU, whose gradient nothing needs.
pub fn differentiable_group_norm(
    x: &Tensor,
    groups: usize,
    (scale, shift): (&Tensor, &Tensor),
    eps: f64,
    activation: Activation,
) -> Result<Tensor> {
    if activation == Activation::Relu {
        candle_core::bail!("group norm: no gradient through {activation:?}");
    }
    let norm = GroupNorm {
        groups,
        eps,
        is_silu: activation == Activation::Silu,
    };
    x.contiguous()?
        .apply_op3(&scale.contiguous()?, &shift.contiguous()?, norm)
}

struct GroupNorm {
    groups: usize,
    eps: f64,
    is_silu: bool,
}

/// What the gradient of one image is made of.
struct OfImage {
    by_x: Vec<f32>,
    /// By scale and shift of each channel.
    by_affine: Vec<[f64; 2]>,
}

impl GroupNorm {
    /// Places of an image, and channels.
    fn sizes(&self, x: &[usize], scale: usize) -> Result<(usize, usize)> {
        match *x {
            [_, height, width, channels]
                if channels == scale
                    && height * width > 0
                    && self.groups > 0
                    && channels > 0
                    && channels.is_multiple_of(self.groups) =>
            {
                Ok((height * width, channels))
            }
            _ => candle_core::bail!(
                "group norm: {x:?} for {scale} channels in {} groups",
                self.groups
            ),
        }
    }

    fn of_image(&self, x: &[f32], by_y: &[f32], (scale, shift): (&[f32], &[f32])) -> OfImage {
        let channels = scale.len();
        let size = channels / self.groups;
        let count = (x.len() / self.groups) as f64;
        let mut sums = vec![0.0; 2 * channels];
        channel_sums(x, &mut sums);
        // (mean, 1 / standard deviation) of each group
        let moments: Vec<(f64, f64)> = sums
            .chunks_exact(2 * size)
            .map(|group| {
                let sum: f64 = group.iter().step_by(2).sum();
                let squares: f64 = group.iter().skip(1).step_by(2).sum();
                let mean = sum / count;
                let variance = (squares / count - mean * mean).max(0.0);
                (mean, (variance + self.eps).sqrt().recip())
            })
            .collect();
        let of_group = |channel: usize| moments.get(channel / size).copied().unwrap_or((0.0, 0.0));
        let affine = scale.iter().zip(shift).enumerate();
        let (factors, offsets): (Vec<f32>, Vec<f32>) = affine
            .map(|(channel, (scale, shift))| {
                let (mean, inverse) = of_group(channel);
                let factor = f64::from(*scale) * inverse;
                (factor as f32, (f64::from(*shift) - mean * factor) as f32)
            })
            .unzip();

        // By what goes into the activation, and its sums with and without x.
        let mut by_x = by_y.to_vec();
        sums.fill(0.0);
        through_activation(&mut by_x, x, &factors, &offsets, self.is_silu, &mut sums);
        let by_affine: Vec<[f64; 2]> = sums
            .chunks_exact(2)
            .enumerate()
            .map(|(channel, pair)| {
                let (plain, with_x) = match pair {
                    [plain, with_x] => (*plain, *with_x),
                    _ => (0.0, 0.0),
                };
                let (mean, inverse) = of_group(channel);
                [inverse * (with_x - mean * plain), plain]
            })
            .collect();
        // What mean and variance take away, for each group.
        let scaled = by_affine.iter().zip(scale);
        let scaled: Vec<[f64; 2]> = scaled
            .map(|(pair, scale)| pair.map(|value| value * f64::from(*scale) / count))
            .collect();
        let taken: Vec<[f64; 2]> = scaled
            .chunks_exact(size)
            .map(|group| {
                group
                    .iter()
                    .fold([0.0; 2], |[a, b], [scale, shift]| [a + scale, b + shift])
            })
            .collect();
        let (slopes, constants): (Vec<f32>, Vec<f32>) = (0..channels)
            .map(|channel| {
                let (mean, inverse) = of_group(channel);
                let [by_variance, by_mean] = taken.get(channel / size).copied().unwrap_or_default();
                let slope = inverse * inverse * by_variance;
                (-slope as f32, (slope * mean - inverse * by_mean) as f32)
            })
            .unzip();
        through_norm(&mut by_x, x, &factors, &slopes, &constants);
        OfImage { by_x, by_affine }
    }
}

impl CustomOp3 for GroupNorm {
    fn name(&self) -> &'static str {
        "group-norm"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        scale: &CpuStorage,
        scale_layout: &Layout,
        shift: &CpuStorage,
        shift_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let affine = (slice(scale, scale_layout)?, slice(shift, shift_layout)?);
        let (pixels, _) = self.sizes(x_layout.dims(), affine.0.len())?;
        let mut y = slice(x, x_layout)?.to_vec();
        let activation = match self.is_silu {
            true => Activation::Silu,
            false => Activation::None,
        };
        group_norm(&mut y, pixels, self.groups, affine, self.eps, activation);
        Ok((CpuStorage::F32(y), x_layout.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        scale: &Tensor,
        shift: &Tensor,
        _: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let gradient = gradient.contiguous()?;
        let (hx, hscale, hshift, hg) = (host(x), host(scale), host(shift), host(&gradient));
        let (vx, vg) = (hx.values()?, hg.values()?);
        let affine = (hscale.values()?, hshift.values()?);
        let (pixels, channels) = self.sizes(x.dims(), affine.0.len())?;
        let images: Vec<OfImage> = vx
            .par_chunks_exact(pixels * channels)
            .zip(vg.par_chunks_exact(pixels * channels))
            .map(|(x, gradient)| self.of_image(x, gradient, affine))
            .collect();
        let mut by_x = Vec::with_capacity(vx.len());
        let mut sums = vec![[0.0; 2]; channels];
        // In order, so that the sums do not depend on the number of threads.
        for image in images {
            by_x.extend(image.by_x);
            for (sum, own) in sums.iter_mut().zip(image.by_affine) {
                *sum = [sum[0] + own[0], sum[1] + own[1]];
            }
        }
        let (by_scale, by_shift): (Vec<f32>, Vec<f32>) = sums
            .into_iter()
            .map(|[scale, shift]| (scale as f32, shift as f32))
            .unzip();
        let tensor =
            |values: Vec<f32>, like: &Tensor| Tensor::from_vec(values, like.shape(), like.device());
        Ok((
            Some(tensor(by_x, x)?),
            Some(tensor(by_scale, scale)?),
            Some(tensor(by_shift, shift)?),
        ))
    }
}

vectorised! {
    /// `gradient` (pixels, channels) by the output becomes that by what goes into the activation; its sum over the pixels
    /// and that of its product with `x` are added to `sums` (channels, 2).
    fn through_activation(
        gradient: &mut [f32],
        x: &[f32],
        factors: &[f32],
        offsets: &[f32],
        is_silu: bool,
        sums: &mut [f64],
    ) {
        let channels = factors.len();
        let (mut plain, mut products) = (vec![0f32; channels], vec![0f32; channels]);
        let blocks = gradient.chunks_mut(PIXELS * channels).zip(x.chunks(PIXELS * channels));
        for (gradient, x) in blocks {
            plain.fill(0.0);
            products.fill(0.0);
            let pixels = gradient.chunks_exact_mut(channels).zip(x.chunks_exact(channels));
            for (gradient, x) in pixels {
                if is_silu {
                    let affine = factors.iter().zip(offsets);
                    for ((g, x), (factor, offset)) in gradient.iter_mut().zip(x).zip(affine) {
                        let input = x.mul_add(*factor, *offset);
                        let part = sigmoid(input);
                        *g *= part * (1.0 + input * (1.0 - part));
                    }
                }
                let totals = plain.iter_mut().zip(&mut products);
                for ((g, x), (plain, product)) in gradient.iter().zip(x).zip(totals) {
                    *plain += g;
                    *product = g.mul_add(*x, *product);
                }
            }
            for ((pair, sum), product) in sums.chunks_exact_mut(2).zip(&plain).zip(&products) {
                if let [total, total_product] = pair {
                    *total += f64::from(*sum);
                    *total_product += f64::from(*product);
                }
            }
        }
    }
}

vectorised! {
    /// `gradient` (pixels, channels) by the normalised and scaled values becomes that by `x`.
    fn through_norm(
        gradient: &mut [f32],
        x: &[f32],
        factors: &[f32],
        slopes: &[f32],
        constants: &[f32],
    ) {
        let channels = factors.len();
        for (gradient, x) in gradient.chunks_exact_mut(channels).zip(x.chunks_exact(channels)) {
            let lines = slopes.iter().zip(constants);
            for (((g, x), factor), (slope, constant)) in gradient.iter_mut().zip(x).zip(factors).zip(lines) {
                *g = g.mul_add(*factor, x.mul_add(*slope, *constant));
            }
        }
    }
}
