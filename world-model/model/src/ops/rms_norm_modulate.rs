//! Root-mean-square normalisation without affine parameters, then a shift and a scale per frame.

use candle_core::{CpuStorage, CustomOp2, D, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{host, slice};
use super::reduction::dot;
use super::vectorised::vectorised;
use crate::Kernels;

const EPSILON: f32 = 1e-6;

/// `x` (.., N, d) normalised over d, times (1 + scale) plus shift.
///
/// `modulation` is (frames, chunks * d) with as many frames as `x` has groups of N tokens; shift
/// and scale are its chunks of those numbers.
///
/// # Errors
/// If the shapes do not fit.
pub(crate) fn rms_norm_modulate(
    kernels: Kernels,
    x: &Tensor,
    modulation: &Tensor,
    shift: usize,
    scale: usize,
) -> Result<Tensor> {
    let op = RmsNormModulate { shift, scale };
    if kernels.takes_kernel(x) {
        return x.contiguous()?.apply_op2(&modulation.contiguous()?, op);
    }
    op.plain(x, modulation)
}

struct RmsNormModulate {
    shift: usize,
    scale: usize,
}

impl RmsNormModulate {
    fn plain(&self, x: &Tensor, modulation: &Tensor) -> Result<Tensor> {
        let (d, _, _) = self.sizes(x.shape(), modulation.shape())?;
        let frames = modulation.dim(0)?;
        let chunk = |number: usize| modulation.narrow(1, number * d, d)?.unsqueeze(1);
        let rows = x.reshape((frames, (), d))?;
        let mean_square = rows.sqr()?.mean_keepdim(D::Minus1)?;
        let normed = rows.broadcast_div(&(mean_square + f64::from(EPSILON))?.sqrt()?)?;
        let scaled = normed.broadcast_mul(&(chunk(self.scale)? + 1.0)?)?;
        let shifted = scaled.broadcast_add(&chunk(self.shift)?)?;
        shifted.reshape(x.shape())
    }

    /// Width of a token and of a frame's modulation, number of values in a frame.
    fn sizes(&self, x: &Shape, modulation: &Shape) -> Result<(usize, usize, usize)> {
        let (frames, width) = modulation.dims2()?;
        let &[.., tokens, d] = x.dims() else {
            candle_core::bail!("rms_norm_modulate: expected (.., N, d), got {x:?}");
        };
        if x.elem_count() != frames * tokens * d || width < d * (1 + self.shift.max(self.scale)) {
            candle_core::bail!("rms_norm_modulate: {x:?} with a modulation of {modulation:?}");
        }
        Ok((d, width, tokens * d))
    }
}

/// 1 / root mean square.
#[inline(always)]
fn inverse_rms(row: &[f32]) -> f32 {
    1.0 / (dot(row, row) / row.len() as f32 + EPSILON).sqrt()
}

impl CustomOp2 for RmsNormModulate {
    fn name(&self) -> &'static str {
        "rms_norm_modulate"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (d, width, frame) = self.sizes(l1.shape(), l2.shape())?;
        let (x, modulation) = (slice(s1, l1)?, slice(s2, l2)?);
        let mut out = vec![0.0; x.len()];
        out.par_chunks_mut(frame)
            .zip(x.par_chunks(frame))
            .zip(modulation.par_chunks(width))
            .for_each(|((out, x), modulation)| {
                let shift = &modulation[self.shift * d..][..d];
                let scale = &modulation[self.scale * d..][..d];
                forward_frame(out, x, shift, scale);
            });
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        modulation: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (d, width, frame) = self.sizes(x.shape(), modulation.shape())?;
        let grad = grad.contiguous()?;
        let (hx, hm, hg) = (host(x), host(modulation), host(&grad));
        let (vx, vm, vg) = (hx.values()?, hm.values()?, hg.values()?);
        let mut grad_x = vec![0.0; vx.len()];
        let mut grad_modulation = vec![0.0; vm.len()];
        grad_x
            .par_chunks_mut(frame)
            .zip(grad_modulation.par_chunks_mut(width))
            .zip(vx.par_chunks(frame))
            .zip(vg.par_chunks(frame))
            .zip(vm.par_chunks(width))
            .for_each(|((((grad_x, grad_modulation), x), g), modulation)| {
                let scale = &modulation[self.scale * d..][..d];
                let mut grad_shift = vec![0.0; d];
                let mut grad_scale = vec![0.0; d];
                backward_frame(grad_x, x, g, scale, &mut grad_shift, &mut grad_scale);
                grad_modulation[self.shift * d..][..d].copy_from_slice(&grad_shift);
                grad_modulation[self.scale * d..][..d].copy_from_slice(&grad_scale);
            });
        Ok((
            Some(Tensor::from_vec(grad_x, x.shape(), x.device())?),
            Some(Tensor::from_vec(
                grad_modulation,
                modulation.shape(),
                x.device(),
            )?),
        ))
    }
}

vectorised! {
    /// `x` (rows, d) normalised, times 1 + `scale` (d), plus `shift` (d), to `out` (rows, d).
    pub(crate) fn forward_frame(out: &mut [f32], x: &[f32], shift: &[f32], scale: &[f32]) {
        let d = scale.len();
        for (out, x) in out.chunks_exact_mut(d).zip(x.chunks_exact(d)) {
            let r = inverse_rms(x);
            for (((out, x), shift), scale) in out.iter_mut().zip(x).zip(shift).zip(scale) {
                *out = (x * r).mul_add(1.0 + scale, *shift);
            }
        }
    }
}

vectorised! {
    /// Of the gradient `g` by the result: writes `grad_x` (rows, d), adds to `grad_shift` and `grad_scale` (d).
    pub(crate) fn backward_frame(
        grad_x: &mut [f32],
        x: &[f32],
        g: &[f32],
        scale: &[f32],
        grad_shift: &mut [f32],
        grad_scale: &mut [f32],
    ) {
        let d = scale.len();
        let rows = grad_x.chunks_exact_mut(d).zip(x.chunks_exact(d));
        for ((grad_x, x), g) in rows.zip(g.chunks_exact(d)) {
            backward_row(grad_x, x, g, scale, grad_shift, grad_scale);
        }
    }
}

/// With n = x r the normalised row and h = g (1 + scale): the gradient of x is
/// r (h - n mean(h n)), that of shift g, that of scale g n.
#[inline(always)]
fn backward_row(
    grad_x: &mut [f32],
    x: &[f32],
    g: &[f32],
    scale: &[f32],
    grad_shift: &mut [f32],
    grad_scale: &mut [f32],
) {
    let r = inverse_rms(x);
    for ((h, g), scale) in grad_x.iter_mut().zip(g).zip(scale) {
        *h = g * (1.0 + scale);
    }
    // mean(h n) r, to be multiplied by n r = x r^2 / r.
    let factor = dot(grad_x, x) * r * r * r / x.len() as f32;
    let inputs = x.iter().zip(g);
    let outputs = grad_x.iter_mut().zip(grad_shift).zip(grad_scale);
    for ((x, g), ((grad_x, grad_shift), grad_scale)) in inputs.zip(outputs) {
        *grad_x = *grad_x * r - x * factor;
        *grad_shift += g;
        *grad_scale += g * x * r;
    }
}

#[cfg(test)]
mod tests {
    use super::super::comparison::{check_gradients, check_refused, check_same, random};
    use super::*;

    #[test]
    fn the_kernel_is_the_plain_form() {
        for d in [4, 16, 24] {
            let (x, modulation) = (random(&[2, 3, 5, d], 1), random(&[6, 3 * d], 2));
            for (shift, scale) in [(0, 1), (2, 0)] {
                check_same("rms_norm_modulate", |kernels| {
                    rms_norm_modulate(kernels, &x, &modulation, shift, scale)
                });
            }
            check_refused("with a modulation of", |kernels| {
                rms_norm_modulate(kernels, &x, &modulation, 0, 3)
            });
        }
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        for d in [8, 20] {
            let inputs = [random(&[2, 2, 3, d], 1), random(&[4, 3 * d], 2)];
            check_gradients("rms_norm_modulate", &inputs, |kernels, inputs| {
                rms_norm_modulate(kernels, &inputs[0], &inputs[1], 2, 0)
            });
        }
    }
}
