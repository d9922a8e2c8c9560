//! The operations that networks of tokens are made of, whatever computes them.
//!
//! A network is written once, over [`TokenLayers`]. [`TensorLayers`] computes it by tensor operations on any device, with
//! candle's gradients, [`TokenTape`] on kernels of the CPU, with gradients of its own, and [`PackedLayers`] on kernels of the
//! CPU with packed weights.

mod linear;
mod packed;
mod tape;
mod tensors;
mod weight_gradients;

pub(crate) use linear::Linear;
pub(crate) use packed::{PackedLayers, Rows};
pub(crate) use tape::{Sizes, TokenTape};
pub(crate) use tensors::TensorLayers;
pub use weight_gradients::WeightGradients;

use std::sync::Arc;

use super::AttentionPattern;
use crate::Result;

/// What computes the operations of a network of tokens.
///
/// A value is rows of tokens, or the modulation of frames: a row of chunks for each, every chunk as wide as a token.
pub(crate) trait TokenLayers {
    /// The weights of a linear layer.
    type Linear;
    /// A batch of rows.
    type Value;

    /// Every row of `x` through `linear`.
    fn linear(&mut self, linear: &Self::Linear, x: &Self::Value) -> Result<Self::Value>;

    /// Every row of `x` divided by its root mean square, times 1 + scale, plus shift. Shift is chunk `first` of
    /// `modulation`, scale the next one.
    fn norm_modulate(
        &mut self,
        x: &Self::Value,
        modulation: &Self::Value,
        first: usize,
    ) -> Result<Self::Value>;

    /// SwiGLU of every row of `x` through `linear`.
    fn linear_swiglu(&mut self, linear: &Self::Linear, x: &Self::Value) -> Result<Self::Value>;

    /// `residual` plus every row of `x` through `linear`, times chunk `gate` of `modulation`.
    fn linear_gated(
        &mut self,
        linear: &Self::Linear,
        x: &Self::Value,
        residual: Self::Value,
        modulation: &Self::Value,
        gate: usize,
    ) -> Result<Self::Value>;
}

/// Operations whose gradients only candle computes.
pub(crate) trait HeadLayers: TokenLayers {
    /// x times the logistic function of x.
    fn silu(&mut self, x: Self::Value) -> Result<Self::Value>;

    /// `x` plus `y`, of the same shape.
    fn sum(&mut self, x: Self::Value, y: &Self::Value) -> Result<Self::Value>;

    /// Every token of `x` plus its frame's row of `rows`.
    fn add_to_frames(&mut self, x: &Self::Value, rows: &Self::Value) -> Result<Self::Value>;
}

/// Operations of whole clips, computed without what earlier passes kept.
pub(crate) trait ClipLayers: TokenLayers {
    /// Attention of the queries, keys and values `qkv`, side by side in every row.
    fn attention(
        &mut self,
        qkv: &Self::Value,
        pattern: &Arc<AttentionPattern>,
    ) -> Result<Self::Value>;

    /// The rows of the last `last` frames of each clip.
    fn last_frames(&mut self, x: Self::Value, last: usize) -> Result<Self::Value>;
}

/// Makes linear layers of a network's weights.
pub(crate) trait LinearSource {
    /// The weights of a linear layer.
    type Linear;

    /// The layer of a name, with a bias if the network has one of that name.
    fn linear(&mut self, name: &str) -> Result<Self::Linear>;

    /// The same of a layer that is sensitive to rounding.
    fn sensitive(&mut self, name: &str) -> Result<Self::Linear>;
}
