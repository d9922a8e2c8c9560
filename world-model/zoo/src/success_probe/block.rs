//! A block of the success probe.

use candle_core::{D, Tensor};
use wm_model::Kernels;

use super::SuccessProbeConfig;
use super::names::Names;
use super::norm::RmsNorm;
use crate::Result;
use crate::layers::{Dropout, Linear, attention};
use crate::loader::Loader;
use crate::vit::{Mlp, join_heads, split_heads};

/// Attention within a frame, over time and to the text, then a feed-forward network.
#[derive(Clone, Debug)]
pub(super) struct ProbeBlock {
    norms: [RmsNorm; 4],
    spatial: Attention,
    temporal: Attention,
    cross: Attention,
    ffn: Mlp,
}

impl ProbeBlock {
    pub(super) fn load(
        config: &SuccessProbeConfig,
        names: Names,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        let (width, ffn) = (config.hidden, config.ffn);
        let norm = |i: usize| RmsNorm::load(config, loader, &format!("norm{i}"), width);
        let attention = |name: &str| Attention::load(config, names, &loader.at(name));
        Ok(Self {
            norms: [norm(1)?, norm(2)?, norm(3)?, norm(4)?],
            spatial: attention("spatial_attn")?,
            temporal: attention("temporal_attn")?,
            cross: attention("cross_attn")?,
            ffn: Mlp::SwiGlu {
                gate_and_value: loader.linear("ffn.w12", width, 2 * ffn)?,
                out: loader.linear("ffn.w3", ffn, width)?,
                kernels: loader.kernels(),
            },
        })
    }

    /// `x` (B, T, P, d), `text` (B, L, d), `mask` added to the scores of the text.
    pub(super) fn forward(
        &self,
        x: &Tensor,
        text: &Tensor,
        mask: Option<&Tensor>,
        dropout: &mut Dropout<'_>,
    ) -> Result<Tensor> {
        let (b, t, p, d) = x.dims4()?;
        let [n1, n2, n3, n4] = &self.norms;

        let frames = n1.forward(x)?.reshape((b * t, p, d))?;
        let seen = self.spatial.forward(&frames, &frames, None)?;
        let x = (x + dropout.apply(&seen.reshape((b, t, p, d))?)?)?;

        let places = n2.forward(&x)?.transpose(1, 2)?.contiguous()?;
        let places = places.reshape((b * p, t, d))?;
        let seen = self.temporal.forward(&places, &places, None)?;
        let seen = seen.reshape((b, p, t, d))?.transpose(1, 2)?.contiguous()?;
        let x = (x + dropout.apply(&seen)?)?;

        let tokens = n3.forward(&x)?.reshape((b, t * p, d))?;
        let read = self.cross.forward(&tokens, text, mask)?;
        let x = (x + dropout.apply(&read.reshape((b, t, p, d))?)?)?;

        let fed = self
            .ffn
            .out()
            .forward(&self.ffn.hidden(&n4.forward(&x)?)?)?;
        Ok((x + dropout.apply(&fed)?)?)
    }
}

/// Multi-head attention without bias, with normalised queries and keys.
#[derive(Clone, Debug)]
struct Attention {
    q: Linear,
    k: Linear,
    v: Linear,
    out: Linear,
    q_norm: RmsNorm,
    k_norm: RmsNorm,
    heads: usize,
    kernels: Kernels,
}

impl Attention {
    fn load(config: &SuccessProbeConfig, names: Names, loader: &Loader<'_>) -> Result<Self> {
        let width = config.hidden;
        let linear = |name: &str| loader.linear_no_bias(name, width, width);
        let norm = |name: &str| {
            let norm = RmsNorm::load(config, loader, name, width / config.heads)?;
            Ok::<_, crate::Error>(norm.for_heads())
        };
        let [q, k, v, out] = names.attention();
        Ok(Self {
            q: linear(q)?,
            k: linear(k)?,
            v: linear(v)?,
            out: linear(out)?,
            q_norm: norm("q_norm")?,
            k_norm: norm("k_norm")?,
            heads: config.heads,
            kernels: loader.kernels(),
        })
    }

    /// `x` (N, L, d) reads from `source` (N, M, d).
    fn forward(&self, x: &Tensor, source: &Tensor, mask: Option<&Tensor>) -> Result<Tensor> {
        let project = |linear: &Linear, x: &Tensor| split_heads(&linear.forward(x)?, self.heads);
        let q = self.q_norm.forward(&project(&self.q, x)?)?;
        let k = self.k_norm.forward(&project(&self.k, source)?)?;
        let v = project(&self.v, source)?;
        let scale = 1.0 / (q.dim(D::Minus1)? as f64).sqrt();
        let mixed = attention((self.kernels, self.out.format()), [&q, &k, &v], scale, mask)?;
        self.out.forward(&join_heads(&mixed)?)
    }
}
