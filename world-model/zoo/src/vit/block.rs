//! The block that all encoders, the adapter and the inverse dynamics model are made of.

use candle_core::Tensor;

use super::{Mlp, Projections, Rotary, SelfAttention};
use crate::Result;
use crate::layers::{Activation, Dropout, LayerNorm, Linear};
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

/// Names of a block's linear layers; those of its norms are `norm1` and `norm2` everywhere.
#[derive(Debug)]
pub(crate) struct BlockNames {
    pub(crate) qkv: &'static str,
    pub(crate) out: &'static str,
    pub(crate) first: &'static str,
    pub(crate) second: &'static str,
}

impl BlockNames {
    /// timm's.
    pub(crate) const TIMM: Self = Self {
        qkv: "attn.qkv",
        out: "attn.proj",
        first: "mlp.fc1",
        second: "mlp.fc2",
    };
}

impl Block {
    /// A block as in timm: one product for queries, keys and values, exact GELU, no LayerScale. Sizes are the width, the
    /// number of heads and the width of the feed-forward network; `eps` is that of both norms.
    pub(crate) fn load(
        loader: &Loader<'_>,
        names: &BlockNames,
        (width, heads, mlp): (usize, usize, usize),
        eps: f64,
    ) -> Result<Self> {
        Ok(Self {
            attention_norm: loader.layer_norm("norm1", width, eps)?,
            attention: SelfAttention {
                projections: Projections::Fused(loader.linear(names.qkv, width, 3 * width)?),
                out: loader.linear(names.out, width, width)?,
                heads,
                kernels: loader.kernels(),
            },
            attention_scale: None,
            mlp_norm: loader.layer_norm("norm2", width, eps)?,
            mlp: Mlp::Plain {
                first: loader.linear(names.first, width, mlp)?,
                activation: Activation::GeluExact,
                second: loader.linear(names.second, mlp, width)?,
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
        self.forward_dropping(x, mask, rotary, &mut Dropout::none())
    }

    /// The same in training, with dropout of what each half adds.
    pub(crate) fn forward_dropping(
        &self,
        x: &Tensor,
        mask: Option<&Tensor>,
        rotary: Option<&Rotary>,
        dropout: &mut Dropout<'_>,
    ) -> Result<Tensor> {
        let normed = self.attention_norm.forward(x)?;
        let mixed = self.attention.mix(&normed, mask, rotary)?;
        let scale = self.attention_scale.as_ref();
        let x = add(&self.attention.out, &mixed, x, scale, dropout)?;
        let hidden = self.mlp.hidden(&self.mlp_norm.forward(&x)?)?;
        add(
            self.mlp.out(),
            &hidden,
            &x,
            self.mlp_scale.as_ref(),
            dropout,
        )
    }
}

/// `x` plus the product of `update`, with dropout in training.
fn add(
    product: &Linear,
    update: &Tensor,
    x: &Tensor,
    scale: Option<&Tensor>,
    dropout: &mut Dropout<'_>,
) -> Result<Tensor> {
    if dropout.is_none() {
        return product.forward_onto(update, x, scale);
    }
    let update = dropout.apply(&product.forward(update)?)?;
    Ok(match scale {
        Some(scale) => (x + update.broadcast_mul(scale)?)?,
        None => (x + update)?,
    })
}
