//! Multi-head attention over short sequences, from the fused query-key-value projection to the
//! weighted values, in one operation: normalisation of queries and keys, rotary embedding, scores,
//! softmax and weighted sum.
//!
//! Each (sequence, head) is small enough for the first-level cache, so nothing but the result is
//! written to memory; the backward pass computes the attention weights anew.

mod head;
mod product;

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{host, slice};
use super::rotary::RotaryTable;
use super::vectorised::vectorised;
use head::HeadKernel;

/// Head dimensions are multiples of this: pairs of channels, turned by two positions.
pub const HEAD_DIM_MULTIPLE: usize = 4;

/// Which tokens of (B, T, N) form a sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The N tokens of a frame.
    Space,
    /// The T frames at one place.
    Time,
}

/// Who attends to whom, and where the tokens of a sequence are.
#[derive(Clone, Debug)]
pub struct AttentionPattern {
    axis: Axis,
    heads: usize,
    rotary: RotaryTable,
    /// Added to the scores: 0 where the key is visible, -inf where not; (length, padded length).
    bias: Vec<f32>,
}

impl AttentionPattern {
    /// `visible(query, key)` tells whether a query attends to a key; each must see at least one.
    ///
    /// # Errors
    /// If the head dimension is not a multiple of [`HEAD_DIM_MULTIPLE`], or a query sees nothing.
    pub fn new(
        axis: Axis,
        heads: usize,
        rotary: RotaryTable,
        visible: impl Fn(usize, usize) -> bool,
    ) -> Result<Self> {
        if heads == 0 || !rotary.head_dim().is_multiple_of(HEAD_DIM_MULTIPLE) {
            candle_core::bail!(
                "attention: {heads} heads of {} channels, expected a multiple of \
                 {HEAD_DIM_MULTIPLE}",
                rotary.head_dim()
            );
        }
        let length = rotary.len();
        let padded = length.next_multiple_of(product::LANES);
        let mut bias = vec![f32::NEG_INFINITY; length * padded];
        for (query, row) in bias.chunks_exact_mut(padded.max(1)).enumerate() {
            let mut any = false;
            for (key, bias) in row.iter_mut().take(length).enumerate() {
                if visible(query, key) {
                    *bias = 0.0;
                    any = true;
                }
            }
            if !any {
                candle_core::bail!("attention: query {query} sees no key");
            }
        }
        Ok(Self {
            axis,
            heads,
            rotary,
            bias,
        })
    }
}

/// Attention of `qkv` (B, T, N, 3 d), rows q | k | v, each head-major: (B, T, N, d).
///
/// # Errors
/// If the shape does not fit the pattern.
pub fn attention(qkv: &Tensor, pattern: &Arc<AttentionPattern>) -> Result<Tensor> {
    qkv.contiguous()?.apply_op1(Attention(pattern.clone()))
}

struct Attention(Arc<AttentionPattern>);

/// Sequences that lie together in memory: token `i` of sequence `s` is row s + i * stride.
#[derive(Clone, Copy)]
struct Group {
    sequences: usize,
    stride: usize,
    rows: usize,
    /// Values of a token of the result.
    d: usize,
}

impl Attention {
    fn group(&self, qkv: &Shape) -> Result<Group> {
        let (_, t, n, width) = qkv.dims4()?;
        let d = self.0.heads * self.0.rotary.head_dim();
        let (length, group) = match self.0.axis {
            Axis::Space => (n, (1, 1, n)),
            Axis::Time => (t, (n, n, t * n)),
        };
        if width != 3 * d || length != self.0.rotary.len() || t * n == 0 {
            candle_core::bail!(
                "attention: {qkv:?} for {} heads of {} channels over {:?} of length {}",
                self.0.heads,
                self.0.rotary.head_dim(),
                self.0.axis,
                self.0.rotary.len()
            );
        }
        let (sequences, stride, rows) = group;
        Ok(Group {
            sequences,
            stride,
            rows,
            d,
        })
    }

    fn kernel(&self) -> HeadKernel<'_> {
        HeadKernel::new(&self.0.rotary, &self.0.bias)
    }
}

impl CustomOp1 for Attention {
    fn name(&self) -> &'static str {
        "attention"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let group = self.group(layout.shape())?;
        let qkv = slice(storage, layout)?;
        let (b, t, n, _) = layout.shape().dims4()?;
        let d = group.d;
        let mut out = vec![0.0; b * t * n * d];
        out.par_chunks_mut(group.rows * d)
            .zip(qkv.par_chunks(group.rows * 3 * d))
            .for_each_init(
                || self.kernel(),
                |kernel, (out, qkv)| forward_group(kernel, out, qkv, group, self.0.heads),
            );
        Ok((CpuStorage::F32(out), (b, t, n, d).into()))
    }

    fn bwd(&self, qkv: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let group = self.group(qkv.shape())?;
        let d = group.d;
        let grad = grad.contiguous()?;
        let (hq, hg) = (host(qkv), host(&grad));
        let (vq, vg) = (hq.values()?, hg.values()?);
        let mut out = vec![0.0; vq.len()];
        out.par_chunks_mut(group.rows * 3 * d)
            .zip(vq.par_chunks(group.rows * 3 * d))
            .zip(vg.par_chunks(group.rows * d))
            .for_each_init(
                || self.kernel(),
                |kernel, ((out, qkv), grad)| {
                    backward_group(kernel, out, qkv, grad, group, self.0.heads);
                },
            );
        Ok(Some(Tensor::from_vec(out, qkv.shape(), qkv.device())?))
    }
}

vectorised! {
    fn forward_group(
        kernel: &mut HeadKernel<'_>,
        out: &mut [f32],
        qkv: &[f32],
        group: Group,
        heads: usize,
    ) {
        for sequence in 0..group.sequences {
            for head in 0..heads {
                kernel.load(qkv, sequence, group.stride, group.d, head);
                kernel.forward();
                kernel.store(out, sequence, group.stride, group.d, head);
            }
        }
    }
}

vectorised! {
    fn backward_group(
        kernel: &mut HeadKernel<'_>,
        out: &mut [f32],
        qkv: &[f32],
        grad: &[f32],
        group: Group,
        heads: usize,
    ) {
        for sequence in 0..group.sequences {
            for head in 0..heads {
                kernel.load(qkv, sequence, group.stride, group.d, head);
                kernel.load_grad(grad, sequence, group.stride, group.d, head);
                kernel.backward();
                kernel.store_grad(out, qkv, sequence, group.stride, group.d, head);
            }
        }
    }
}

#[cfg(test)]
mod tests;
