//! Networks of tokens by tensor operations.

use std::sync::Arc;

use candle_core::{DType, Tensor};

use super::{ClipLayers, HeadLayers, Linear, TokenLayers};
use crate::Kernels;
use crate::Result;
use crate::ops::{self, AttentionPattern, gated_residual, rms_norm_modulate, swiglu};

/// Tensor operations. Tokens are (B, T, N, d), modulations (B T, chunks d).
#[derive(Clone, Copy, Debug)]
pub(crate) struct TensorLayers {
    kernels: Kernels,
    /// Number format of the inputs of products and of attention; everything else is in f32.
    format: DType,
    /// Clips of a batch.
    clips: usize,
}

impl TensorLayers {
    /// Computed by `kernels` in f32, for a batch of so many clips.
    pub(crate) fn new(kernels: Kernels, clips: usize) -> Self {
        Self {
            kernels,
            format: DType::F32,
            clips,
        }
    }

    /// The same with inputs of products and of attention in `format`.
    pub(crate) fn in_format(self, format: DType) -> Self {
        Self { format, ..self }
    }
}

impl TokenLayers for TensorLayers {
    type Linear = Linear;
    type Value = Tensor;

    fn linear(&mut self, linear: &Linear, x: &Tensor) -> Result<Tensor> {
        let bias = linear.bias.as_ref();
        Ok(ops::linear(self.kernels, x, &linear.weight, bias)?)
    }

    fn norm_modulate(&mut self, x: &Tensor, modulation: &Tensor, first: usize) -> Result<Tensor> {
        let normed = rms_norm_modulate(self.kernels, x, modulation, first, first + 1)?;
        Ok(normed.to_dtype(self.format)?)
    }

    fn linear_swiglu(&mut self, linear: &Linear, x: &Tensor) -> Result<Tensor> {
        let up = self.linear(linear, x)?;
        Ok(swiglu(self.kernels, &up)?)
    }

    fn linear_gated(
        &mut self,
        linear: &Linear,
        x: &Tensor,
        residual: Tensor,
        modulation: &Tensor,
        gate: usize,
    ) -> Result<Tensor> {
        let branch = self.linear(linear, x)?.to_dtype(DType::F32)?;
        let kernels = self.kernels;
        Ok(gated_residual(
            kernels, &residual, &branch, modulation, gate,
        )?)
    }
}

impl HeadLayers for TensorLayers {
    fn silu(&mut self, x: Tensor) -> Result<Tensor> {
        Ok(x.silu()?)
    }

    fn sum(&mut self, x: Tensor, y: &Tensor) -> Result<Tensor> {
        Ok((x + y)?)
    }

    fn add_to_frames(&mut self, x: &Tensor, rows: &Tensor) -> Result<Tensor> {
        let (b, t, n, d) = x.dims4()?;
        let frames = x.reshape((b * t, n, d))?;
        let sum = frames.broadcast_add(&rows.unsqueeze(1)?)?;
        Ok(sum.reshape((b, t, n, d))?)
    }
}

impl ClipLayers for TensorLayers {
    fn attention(&mut self, qkv: &Tensor, pattern: &Arc<AttentionPattern>) -> Result<Tensor> {
        Ok(ops::attention(self.kernels, qkv, pattern)?)
    }

    fn last_frames(&mut self, x: Tensor, last: usize) -> Result<Tensor> {
        // Tokens have the clips in a dimension of their own, modulations do not.
        if x.rank() == 4 {
            let frames = x.dim(1)?;
            return Ok(x.narrow(1, frames - last, last)?);
        }
        let (rows, width) = x.dims2()?;
        let frames = rows / self.clips.max(1);
        if frames == last {
            return Ok(x);
        }
        let all = x.reshape((self.clips, frames, width))?;
        Ok(all.narrow(1, frames - last, last)?.flatten_to(1)?)
    }
}
