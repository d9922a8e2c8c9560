//! The gated activation of the feed-forward networks.

use candle_core::{CpuStorage, CustomOp1, D, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::exponential::sigmoid;
use super::host::{host, slice};
use super::vectorised::vectorised;
use crate::Kernels;

/// Rows that one task handles: enough work to be worth a task, few enough to spread.
const ROWS: usize = 64;

/// silu(first half) * second half over the last dimension: (.., 2h) becomes (.., h).
///
/// # Errors
/// If the last dimension is odd.
pub fn swiglu(kernels: Kernels, x: &Tensor) -> Result<Tensor> {
    if kernels.takes_kernel(x) {
        return x.contiguous()?.apply_op1(Swiglu);
    }
    let h = half(x.shape())?;
    let (gate, value) = (x.narrow(D::Minus1, 0, h)?, x.narrow(D::Minus1, h, h)?);
    gate.silu()? * value
}

/// Half the last dimension.
fn half(shape: &Shape) -> Result<usize> {
    match shape.dims().last() {
        Some(last) if *last > 0 && last.is_multiple_of(2) => Ok(last / 2),
        _ => candle_core::bail!("swiglu: cannot halve {shape:?}"),
    }
}

struct Swiglu;

impl CustomOp1 for Swiglu {
    fn name(&self) -> &'static str {
        "swiglu"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let h = half(layout.shape())?;
        let mut dims = layout.dims().to_vec();
        if let Some(last) = dims.last_mut() {
            *last = h;
        }
        let x = slice(storage, layout)?;
        let mut out = vec![0.0; x.len() / 2];
        out.par_chunks_mut(ROWS * h)
            .zip(x.par_chunks(ROWS * 2 * h))
            .for_each(|(out, x)| forward_rows(out, x, h));
        Ok((CpuStorage::F32(out), Shape::from(dims)))
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let grad = grad.contiguous()?;
        let h = grad.dim(D::Minus1)?;
        let (hx, hg) = (host(x), host(&grad));
        let (vx, vg) = (hx.values()?, hg.values()?);
        let mut out = vec![0.0; vx.len()];
        out.par_chunks_mut(ROWS * 2 * h)
            .zip(vx.par_chunks(ROWS * 2 * h))
            .zip(vg.par_chunks(ROWS * h))
            .for_each(|((out, x), g)| backward_rows(out, x, g, h));
        Ok(Some(Tensor::from_vec(out, x.shape(), x.device())?))
    }
}

vectorised! {
    /// `x` (rows, 2 h) to `out` (rows, h).
    pub(crate) fn forward_rows(out: &mut [f32], x: &[f32], h: usize) {
        for (out, x) in out.chunks_exact_mut(h).zip(x.chunks_exact(2 * h)) {
            let (a, b) = x.split_at(h);
            for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                *out = a * sigmoid(*a) * b;
            }
        }
    }
}

vectorised! {
    /// Of the gradient `g` (rows, h) by the result to that by `x`, `out` (rows, 2 h).
    pub(crate) fn backward_rows(out: &mut [f32], x: &[f32], g: &[f32], h: usize) {
        let rows = out.chunks_exact_mut(2 * h).zip(x.chunks_exact(2 * h));
        for ((out, x), g) in rows.zip(g.chunks_exact(h)) {
            let (a, b) = x.split_at(h);
            let (grad_a, grad_b) = out.split_at_mut(h);
            let outputs = grad_a.iter_mut().zip(grad_b);
            for (((a, b), g), (grad_a, grad_b)) in a.iter().zip(b).zip(g).zip(outputs) {
                let s = sigmoid(*a);
                let silu = a * s;
                *grad_a = g * b * (s + silu * (1.0 - s));
                *grad_b = g * silu;
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
        for shape in [&[2, 3, 40][..], &[70, 6], &[2]] {
            let x = random(shape, 1);
            check_same("swiglu", |kernels| swiglu(kernels, &x));
        }
        let odd = random(&[2, 7], 2);
        check_refused("cannot halve [2, 7]", |kernels| swiglu(kernels, &odd));
    }

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        check_gradients("swiglu", &[random(&[2, 3, 10], 1)], |kernels, inputs| {
            swiglu(kernels, &inputs[0])
        });
    }
}
