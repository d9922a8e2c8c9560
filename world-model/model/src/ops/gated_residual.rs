//! A residual connection whose branch is weighted by a gate per frame.

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{host, slice};
use super::vectorised::vectorised;
use crate::Kernels;

/// `x` + gate * `branch`, both (.., N, d); the gate is chunk `gate` of `modulation`
/// (frames, chunks * d).
///
/// # Errors
/// If the shapes do not fit.
pub(crate) fn gated_residual(
    kernels: Kernels,
    x: &Tensor,
    branch: &Tensor,
    modulation: &Tensor,
    gate: usize,
) -> Result<Tensor> {
    let op = GatedResidual { gate };
    if kernels.takes_kernel(x) {
        let (branch, modulation) = (branch.contiguous()?, modulation.contiguous()?);
        return x.contiguous()?.apply_op3(&branch, &modulation, op);
    }
    op.plain(x, branch, modulation)
}

struct GatedResidual {
    gate: usize,
}

impl GatedResidual {
    fn plain(&self, x: &Tensor, branch: &Tensor, modulation: &Tensor) -> Result<Tensor> {
        let (d, _, _) = self.sizes(x.shape(), branch.shape(), modulation.shape())?;
        let frames = modulation.dim(0)?;
        let gate = modulation.narrow(1, self.gate * d, d)?.unsqueeze(1)?;
        let gated = branch.reshape((frames, (), d))?.broadcast_mul(&gate)?;
        x + gated.reshape(x.shape())?
    }

    /// Width of a token and of a frame's modulation, number of values in a frame.
    fn sizes(
        &self,
        x: &Shape,
        branch: &Shape,
        modulation: &Shape,
    ) -> Result<(usize, usize, usize)> {
        let (frames, width) = modulation.dims2()?;
        let &[.., tokens, d] = x.dims() else {
            candle_core::bail!("gated_residual: expected (.., N, d), got {x:?}");
        };
        if x != branch || x.elem_count() != frames * tokens * d || width < d * (1 + self.gate) {
            candle_core::bail!(
                "gated_residual: {x:?} plus {branch:?} with a modulation of {modulation:?}"
            );
        }
        Ok((d, width, tokens * d))
    }
}

impl CustomOp3 for GatedResidual {
    fn name(&self) -> &'static str {
        "gated_residual"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (d, width, frame) = self.sizes(l1.shape(), l2.shape(), l3.shape())?;
        let (x, branch, modulation) = (slice(s1, l1)?, slice(s2, l2)?, slice(s3, l3)?);
        let mut out = x.to_vec();
        out.par_chunks_mut(frame)
            .zip(branch.par_chunks(frame))
            .zip(modulation.par_chunks(width))
            .for_each(|((out, branch), modulation)| {
                forward_frame(out, branch, &modulation[self.gate * d..][..d]);
            });
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        branch: &Tensor,
        modulation: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (d, width, frame) = self.sizes(x.shape(), branch.shape(), modulation.shape())?;
        let grad = grad.contiguous()?;
        let (hb, hm, hg) = (host(branch), host(modulation), host(&grad));
        let (vb, vm, vg) = (hb.values()?, hm.values()?, hg.values()?);
        let mut grad_branch = vec![0.0; vb.len()];
        let mut grad_modulation = vec![0.0; vm.len()];
        grad_branch
            .par_chunks_mut(frame)
            .zip(grad_modulation.par_chunks_mut(width))
            .zip(vb.par_chunks(frame))
            .zip(vg.par_chunks(frame))
            .zip(vm.par_chunks(width))
            .for_each(
                |((((grad_branch, grad_modulation), branch), g), modulation)| {
                    let gate = &modulation[self.gate * d..][..d];
                    let grad_gate = &mut grad_modulation[self.gate * d..][..d];
                    backward_frame(grad_branch, grad_gate, branch, g, gate);
                },
            );
        Ok((
            Some(grad.clone()),
            Some(Tensor::from_vec(grad_branch, x.shape(), x.device())?),
            Some(Tensor::from_vec(
                grad_modulation,
                modulation.shape(),
                x.device(),
            )?),
        ))
    }
}

vectorised! {
    /// Adds `gate` (d) times `branch` (rows, d) to `out` (rows, d).
    pub(crate) fn forward_frame(out: &mut [f32], branch: &[f32], gate: &[f32]) {
        let d = gate.len();
        for (out, branch) in out.chunks_exact_mut(d).zip(branch.chunks_exact(d)) {
            for ((out, branch), gate) in out.iter_mut().zip(branch).zip(gate) {
                *out = branch.mul_add(*gate, *out);
            }
        }
    }
}

vectorised! {
    /// Of the gradient `g` by the result: writes `grad_branch` (rows, d), adds to `grad_gate` (d).
    pub(crate) fn backward_frame(
        grad_branch: &mut [f32],
        grad_gate: &mut [f32],
        branch: &[f32],
        g: &[f32],
        gate: &[f32],
    ) {
        let d = gate.len();
        let rows = grad_branch.chunks_exact_mut(d).zip(branch.chunks_exact(d));
        for ((grad_branch, branch), g) in rows.zip(g.chunks_exact(d)) {
            let inputs = branch.iter().zip(g).zip(gate);
            let outputs = grad_branch.iter_mut().zip(grad_gate.iter_mut());
            for (((branch, g), gate), (grad_branch, grad_gate)) in inputs.zip(outputs) {
                *grad_branch = g * gate;
                *grad_gate = g.mul_add(*branch, *grad_gate);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::comparison::{check_gradients, check_refused, check_same, random};
    use super::*;

    #[test]
    fn the_kernel_is_the_plain_form() {
        let (x, branch) = (random(&[2, 3, 5, 12], 1), random(&[2, 3, 5, 12], 2));
        let modulation = random(&[6, 36], 3);
        for gate in 0..3 {
            check_same("gated_residual", |kernels| {
                gated_residual(kernels, &x, &branch, &modulation, gate)
            });
        }
        check_refused("with a modulation of [6, 36]", |kernels| {
            gated_residual(kernels, &x, &branch, &modulation, 3)
        });
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        let x = |seed| random(&[2, 2, 3, 5], seed);
        let inputs = [x(1), x(2), random(&[4, 15], 3)];
        check_gradients("gated_residual", &inputs, |kernels, inputs| {
            gated_residual(kernels, &inputs[0], &inputs[1], &inputs[2], 1)
        });
    }
}
