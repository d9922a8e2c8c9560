//! The block that all encoders, the adapter and the inverse dynamics model are made of.

use candle_core::Tensor;

use super::{Activation, Mlp, Projections, Rotary, SelfAttention};
use crate::Result;
use crate::layers::LayerNorm;
use crate::loader::Loader;

/// x += scale * attention(norm(x)); x += scale * mlp(norm(x)), the scales being optional.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) attention_norm: LayerNorm,
    pub(crate) attention: SelfAttention,
    /// LayerScale (width).
    pub(crate) attention_scale: Option<Tensor>,
    pub(crate) mlp_norm: LayerNorm,
    pub(crate) mlp: Mlp,
    /// LayerScale (width).
    pub(crate) mlp_scale: Option<Tensor>,
}

impl Block {
    /// A block in the names and the form of timm: one product for queries, keys and values, exact GELU, no LayerScale.
    /// Sizes are the width, the number of heads and the width of the feed-forward network; `eps` is that of both
    /// normalisations.
    pub(crate) fn load_timm(
        loader: &Loader<'_>,
        (width, heads, mlp): (usize, usize, usize),
        eps: f64,
    ) -> Result<Self> {
        Ok(Self {
            attention_norm: loader.layer_norm("norm1", width, eps)?,
            attention: SelfAttention {
                projections: Projections::Fused(loader.linear("attn.qkv", width, 3 * width)?),
                out: loader.linear("attn.proj", width, width)?,
                heads,
                engine: loader.engine(),
            },
            attention_scale: None,
            mlp_norm: loader.layer_norm("norm2", width, eps)?,
            mlp: Mlp::Plain {
                first: loader.linear("mlp.fc1", width, mlp)?,
                activation: Activation::GeluExact,
                second: loader.linear("mlp.fc2", mlp, width)?,
            },
            mlp_scale: None,
        })
    }

    /// `x` (B, L, width); `mask` as in [`SelfAttention::forward`].
    pub(crate) fn forward(
        &self,
        x: &Tensor,
        mask: Option<&Tensor>,
        rotary: Option<&Rotary>,
    ) -> Result<Tensor> {
        let attended = self
            .attention
            .forward(&self.attention_norm.forward(x)?, mask, rotary)?;
        let x = add_scaled(x, &attended, self.attention_scale.as_ref())?;
        let fed = self.mlp.forward(&self.mlp_norm.forward(&x)?)?;
        add_scaled(&x, &fed, self.mlp_scale.as_ref())
    }
}

fn add_scaled(x: &Tensor, update: &Tensor, scale: Option<&Tensor>) -> Result<Tensor> {
    Ok(match scale {
        Some(scale) => (x + update.broadcast_mul(scale)?)?,
        None => (x + update)?,
    })
}
