//! Multi-head attention over short sequences, from the fused query-key-value projection to the
//! weighted values, in one operation: normalisation of queries and keys, rotary embedding, scores,
//! softmax and weighted sum.
//!
//! Each (sequence, head) is small enough for the first-level cache, so nothing but the result is written to memory; the
//! backward pass recomputes the attention weights.

mod head;
mod product;

use std::sync::{Arc, OnceLock};

use candle_core::{CpuStorage, CustomOp1, D, Device, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{host, slice};
use super::rotary::{RotaryTable, normalise_and_rotate_plain};
use super::vectorised::vectorised;
use crate::Kernels;
use head::{HeadKernel, Place};

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
    tables: OnceLock<Tables>,
}

/// What plain tensor operations computes with, on the device of the first tensor that it is given.
#[derive(Clone, Debug)]
struct Tables {
    /// Cosines and sines, each (length, pairs).
    rotary: (Tensor, Tensor),
    /// The scores' bias, (length, length); none where every query sees every key.
    bias: Option<Tensor>,
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
        let padded = padded(length);
        let mut bias = vec![f32::NEG_INFINITY; length * padded];
        for (query, row) in bias.chunks_exact_mut(padded).enumerate() {
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
            tables: OnceLock::new(),
        })
    }

    /// Kept, so that a pattern's tables go to a device once.
    fn tables(&self, device: &Device) -> Result<&Tables> {
        if let Some(tables) = self.tables.get() {
            return Ok(tables);
        }
        let length = self.rotary.len();
        let rows = self.bias.chunks_exact(padded(length));
        let bias = rows.flat_map(|row| row.iter().copied().take(length));
        let bias = match bias.clone().all(|bias| bias == 0.0) {
            true => None,
            false => {
                let shape = (length, length);
                Some(Tensor::from_vec(bias.collect(), shape, device)?)
            }
        };
        let rotary = self.rotary.tensors(device)?;
        Ok(self.tables.get_or_init(|| Tables { rotary, bias }))
    }
}

impl AttentionPattern {
    /// Writes the result of `qkv` of shape (B, T, N, 3 d), as [`attention`], to all of `out`.
    ///
    /// # Errors
    /// If the shape does not fit the pattern.
    pub(crate) fn forward(&self, shape: &Shape, qkv: &[f32], out: &mut [f32]) -> Result<()> {
        let group = self.group(shape)?;
        out.par_chunks_mut(group.rows * group.d)
            .zip(qkv.par_chunks(group.rows * 3 * group.d))
            .for_each_init(
                || HeadKernel::new(&self.rotary, &self.bias),
                |kernel, (out, qkv)| forward_group(kernel, out, qkv, group, self.heads),
            );
        Ok(())
    }

    /// Writes the gradient by `qkv`, of the gradient `grad` (B, T, N, d) by the result, to all of `out`.
    ///
    /// # Errors
    /// If the shape does not fit the pattern.
    pub(crate) fn backward(
        &self,
        shape: &Shape,
        qkv: &[f32],
        grad: &[f32],
        out: &mut [f32],
    ) -> Result<()> {
        let group = self.group(shape)?;
        out.par_chunks_mut(group.rows * 3 * group.d)
            .zip(qkv.par_chunks(group.rows * 3 * group.d))
            .zip(grad.par_chunks(group.rows * group.d))
            .for_each_init(
                || HeadKernel::new(&self.rotary, &self.bias),
                |kernel, ((out, qkv), grad)| {
                    backward_group(kernel, out, qkv, grad, group, self.heads);
                },
            );
        Ok(())
    }

    fn group(&self, qkv: &Shape) -> Result<Group> {
        let (_, t, n, width) = qkv.dims4()?;
        let d = self.heads * self.rotary.head_dim();
        let (length, group) = match self.axis {
            Axis::Space => (n, (1, 1, n)),
            Axis::Time => (t, (n, n, t * n)),
        };
        if width != 3 * d || length != self.rotary.len() || t * n == 0 {
            candle_core::bail!(
                "attention: {qkv:?} for {} heads of {} channels over {:?} of length {}",
                self.heads,
                self.rotary.head_dim(),
                self.axis,
                self.rotary.len()
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
}

/// Width of the bias's rows: the length rounded up to whole lanes.
fn padded(length: usize) -> usize {
    length.next_multiple_of(product::LANES).max(product::LANES)
}

/// Attention of `qkv` (B, T, N, 3 d), rows q | k | v, each head-major: (B, T, N, d).
///
/// # Errors
/// If the shape does not fit the pattern.
pub fn attention(
    kernels: Kernels,
    qkv: &Tensor,
    pattern: &Arc<AttentionPattern>,
) -> Result<Tensor> {
    let op = Attention(pattern.clone());
    match kernels.takes_kernel(qkv) {
        true => qkv.contiguous()?.apply_op1(op),
        false => op.plain(qkv),
    }
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

impl Group {
    #[inline(always)]
    fn place(self, sequence: usize, head: usize) -> Place {
        Place {
            sequence,
            stride: self.stride,
            d: self.d,
            head,
        }
    }
}

impl Attention {
    fn plain(&self, qkv: &Tensor) -> Result<Tensor> {
        let Group { d, .. } = self.0.group(qkv.shape())?;
        let (b, t, n, _) = qkv.dims4()?;
        let (heads, dim) = (self.0.heads, self.0.rotary.head_dim());
        let tables = self.0.tables(qkv.device())?;
        let parts = qkv.reshape((b, t, n, 3, heads, dim))?;
        // To (3, B, the other axis, heads, length, dim).
        let parts = match self.0.axis {
            Axis::Space => parts.permute((3, 0, 1, 4, 2, 5))?,
            Axis::Time => parts.permute((3, 0, 2, 4, 1, 5))?,
        };
        let part = |i: usize| parts.get(i)?.flatten_to(2)?.contiguous();
        let query = normalise_and_rotate_plain(&part(0)?, &tables.rotary)?;
        let key = normalise_and_rotate_plain(&part(1)?, &tables.rotary)?;
        let scores = (query.matmul(&key.t()?)? / (dim as f64).sqrt())?;
        let scores = match &tables.bias {
            Some(bias) => scores.broadcast_add(bias)?,
            None => scores,
        };
        // Less the largest score, so that no exponential overflows; the softmax is the same for whatever is subtracted,
        // and has no gradient by it.
        let most = scores.max_keepdim(D::Minus1)?.detach();
        let powers = scores.broadcast_sub(&most)?.exp()?;
        let weights = powers.broadcast_div(&powers.sum_keepdim(D::Minus1)?)?;
        let out = weights.matmul(&part(2)?)?;
        let out = match self.0.axis {
            Axis::Space => out
                .reshape((b, t, heads, n, dim))?
                .permute((0, 1, 3, 2, 4))?,
            Axis::Time => out
                .reshape((b, n, heads, t, dim))?
                .permute((0, 3, 1, 2, 4))?,
        };
        out.reshape((b, t, n, d))
    }
}

impl CustomOp1 for Attention {
    fn name(&self) -> &'static str {
        "attention"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (b, t, n, width) = layout.shape().dims4()?;
        let qkv = slice(storage, layout)?;
        let mut out = vec![0.0; qkv.len() / 3];
        self.0.forward(layout.shape(), qkv, &mut out)?;
        Ok((CpuStorage::F32(out), (b, t, n, width / 3).into()))
    }

    fn bwd(&self, qkv: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let grad = grad.contiguous()?;
        let (values, grad) = (host(qkv), host(&grad));
        let mut out = vec![0.0; qkv.elem_count()];
        self.0
            .backward(qkv.shape(), values.values()?, grad.values()?, &mut out)?;
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
                let place = group.place(sequence, head);
                kernel.load(qkv, place);
                kernel.forward();
                kernel.store(out, place);
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
                let place = group.place(sequence, head);
                kernel.load(qkv, place);
                kernel.load_grad(grad, place);
                kernel.backward();
                kernel.store_grad(out, qkv, place);
            }
        }
    }
}

#[cfg(test)]
mod tests;
