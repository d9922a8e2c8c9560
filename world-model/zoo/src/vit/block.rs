//! The block that all encoders, the adapter and the inverse dynamics model are made of.

use candle_core::Tensor;

use super::{Mlp, Rotary, SelfAttention};
use crate::Result;
use crate::layers::LayerNorm;

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
