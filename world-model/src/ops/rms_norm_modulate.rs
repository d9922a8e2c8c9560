//! Root-mean-square normalisation without affine parameters, then a shift and a scale per frame.

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{host, slice};
use super::vectorised::vectorised;

const EPSILON: f32 = 1e-6;

/// `x` (.., N, d) normalised over d, times (1 + scale) plus shift.
///
/// `modulation` is (frames, chunks * d) with as many frames as `x` has groups of N tokens; shift
/// and scale are its chunks of those numbers.
///
/// # Errors
/// If the shapes do not fit.
pub fn rms_norm_modulate(
    x: &Tensor,
    modulation: &Tensor,
    shift: usize,
    scale: usize,
) -> Result<Tensor> {
    x.contiguous()?
        .apply_op2(&modulation.contiguous()?, RmsNormModulate { shift, scale })
}

struct RmsNormModulate {
    shift: usize,
    scale: usize,
}

impl RmsNormModulate {
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
    // Sixteen partial sums: a single one would be a chain of dependent additions.
    let mut sums = [0.0_f32; 16];
    let (chunks, rest) = row.as_chunks::<16>();
    for chunk in chunks {
        for (sum, x) in sums.iter_mut().zip(chunk) {
            *sum = x.mul_add(*x, *sum);
        }
    }
    let total: f32 = sums.iter().sum::<f32>() + rest.iter().map(|x| x * x).sum::<f32>();
    1.0 / (total / row.len() as f32 + EPSILON).sqrt()
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
    fn backward_frame(
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
    let d = x.len();
    let mut sums = [0.0_f32; 16];
    let whole = d - d % 16;
    for i in (0..whole).step_by(16) {
        let (x, g, s) = (&x[i..][..16], &g[i..][..16], &scale[i..][..16]);
        for lane in 0..16 {
            sums[lane] += g[lane] * (1.0 + s[lane]) * x[lane];
        }
    }
    let mut dot: f32 = sums.iter().sum();
    for i in whole..d {
        dot += g[i] * (1.0 + scale[i]) * x[i];
    }
    // mean(h n) r, to be multiplied by n r = x r^2 / r.
    let factor = dot * r * r * r / d as f32;
    let inputs = x.iter().zip(g).zip(scale);
    let outputs = grad_x.iter_mut().zip(grad_shift).zip(grad_scale);
    for (((x, g), scale), ((grad_x, grad_shift), grad_scale)) in inputs.zip(outputs) {
        *grad_x = g * (1.0 + scale) * r - x * factor;
        *grad_shift += g;
        *grad_scale += g * x * r;
    }
}
