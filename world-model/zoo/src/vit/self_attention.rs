//! Attention of tokens among themselves.

use candle_core::{D, Tensor};
use wm_model::Kernels;

use super::Rotary;
use crate::Result;
use crate::layers::{Linear, attention};

/// Where queries, keys and values come from.
#[derive(Clone, Debug)]
pub(crate) enum Projections {
    /// One product; rows q | k | v, each head-major.
    Fused(Linear),
    /// Query, key and value.
    Separate(Box<[Linear; 3]>),
}

/// Multi-head self-attention.
#[derive(Clone, Debug)]
pub(crate) struct SelfAttention {
    pub(crate) projections: Projections,
    pub(crate) out: Linear,
    pub(crate) heads: usize,
    pub(crate) kernels: Kernels,
}

impl SelfAttention {
    /// What `x` (B, L, width) is told, before the last product; `mask` is added to the scores, broadcast to (B, heads, L, L).
    pub(crate) fn mix(
        &self,
        x: &Tensor,
        mask: Option<&Tensor>,
        rotary: Option<&Rotary>,
    ) -> Result<Tensor> {
        let width = x.dim(D::Minus1)?;
        let (q, k, v) = match &self.projections {
            Projections::Fused(qkv) => {
                let qkv = qkv.forward(x)?;
                let part =
                    |i: usize| split_heads(&qkv.narrow(D::Minus1, i * width, width)?, self.heads);
                (part(0)?, part(1)?, part(2)?)
            }
            Projections::Separate(separate) => {
                let [q, k, v] = separate.as_ref();
                let part = |linear: &Linear| split_heads(&linear.forward(x)?, self.heads);
                (part(q)?, part(k)?, part(v)?)
            }
        };
        let (q, k) = match rotary {
            Some(rotary) => (rotary.apply(&q)?, rotary.apply(&k)?),
            None => (q, k),
        };
        let scale = 1.0 / ((width / self.heads) as f64).sqrt();
        let compute = (self.kernels, self.out.format());
        let mixed = attention(compute, [&q, &k, &v], scale, mask)?;
        join_heads(&mixed)
    }
}

/// (B, L, heads * d) to (B, heads, L, d), as a view.
pub(crate) fn split_heads(x: &Tensor, heads: usize) -> Result<Tensor> {
    let (b, l, width) = x.dims3()?;
    Ok(x.reshape((b, l, heads, width / heads))?.transpose(1, 2)?)
}

/// (B, heads, L, d) to (B, L, heads * d).
pub(crate) fn join_heads(x: &Tensor) -> Result<Tensor> {
    let (b, heads, l, d) = x.dims4()?;
    Ok(x.transpose(1, 2)?.reshape((b, l, heads * d))?)
}
