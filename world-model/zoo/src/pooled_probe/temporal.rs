//! One transformer block over the frames.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::{default_max_frames, default_pool, pooled};
use crate::layers::{LayerNorm, Linear};
use crate::sizes::{check_multiple, check_sizes};
use crate::vit::{Block, BlockNames};
use crate::{Loader, Result};

/// Epsilon of every LayerNorm: PyTorch's default.
const LAYER_NORM_EPS: f64 = 1e-5;

/// Names of the block's linear layers, those of the released inverse dynamics model's blocks.
const NAMES: BlockNames = BlockNames {
    qkv: "attn.qkv_proj",
    out: "attn.out_proj",
    first: "mlp.0",
    second: "mlp.3",
};

/// Sizes of the temporal probe. JSON: `{"features": 1024, "max_frames": 64, "pool": 1, "hidden": 256, "heads": 4,
/// "mlp": 1024}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemporalProbeConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Frames of the longest episode, the length of the temporal embedding.
    #[serde(default = "default_max_frames")]
    pub max_frames: usize,
    /// Rows, and columns, that a frame is pooled to; 1 is its mean.
    #[serde(default = "default_pool")]
    pub pool: usize,
    /// Width of the tokens.
    #[serde(default = "default_hidden")]
    pub hidden: usize,
    /// Attention heads.
    #[serde(default = "default_heads")]
    pub heads: usize,
    /// Hidden width of the feed-forward network.
    #[serde(default = "default_mlp")]
    pub mlp: usize,
}

fn default_hidden() -> usize {
    256
}

fn default_heads() -> usize {
    4
}

fn default_mlp() -> usize {
    1024
}

/// A pre-norm transformer block over a CLS token and one token a frame.
///
/// Names: `input_proj.*`, `cls_token` (1, 1, hidden), `temporal_embed` (1, max_frames, hidden), which is added to the
/// frames alone, `block.{norm1,norm2}.*`, `block.attn.{qkv_proj,out_proj}.*`, `block.mlp.{0,3}.*`, `norm.*`, `head.*`.
#[derive(Clone, Debug)]
pub struct TemporalProbe {
    config: TemporalProbeConfig,
    input: Linear,
    /// (1, 1, hidden).
    cls: Tensor,
    /// (1, max_frames, hidden).
    temporal: Tensor,
    block: Block,
    norm: LayerNorm,
    head: Linear,
}

impl TemporalProbe {
    /// Loads the probe.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &TemporalProbeConfig, loader: &Loader<'_>) -> Result<Self> {
        let c = config;
        check_sizes(&[
            ("features", c.features),
            ("max_frames", c.max_frames),
            ("pool", c.pool),
            ("hidden", c.hidden),
            ("heads", c.heads),
            ("mlp", c.mlp),
        ])?;
        check_multiple(("hidden", c.hidden), ("heads", c.heads))?;
        let sizes = (c.hidden, c.heads, c.mlp);
        Ok(Self {
            config: c.clone(),
            input: loader.sensitive().linear(
                "input_proj",
                c.pool * c.pool * c.features,
                c.hidden,
            )?,
            cls: loader.tensor("cls_token", &[1, 1, c.hidden])?,
            temporal: loader.tensor("temporal_embed", &[1, c.max_frames, c.hidden])?,
            block: Block::load(&loader.at("block"), &NAMES, sizes, LAYER_NORM_EPS)?,
            norm: loader.layer_norm("norm", c.hidden, LAYER_NORM_EPS)?,
            head: loader.sensitive().linear("head", c.hidden, 1)?,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &TemporalProbeConfig {
        &self.config
    }

    /// The logit of success (B), f32, of `latents` (B, T, h, w, features).
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward(&self, latents: &Tensor) -> Result<Tensor> {
        let c = &self.config;
        let frames = pooled(latents, c.features, c.pool, c.max_frames)?;
        let (b, t, _) = frames.dims3()?;
        let frames = frames.to_device(self.cls.device())?;
        let frames = self
            .input
            .forward(&frames.to_dtype(self.cls.dtype())?)?
            .broadcast_add(&self.temporal.narrow(1, 0, t)?)?;
        let cls = self.cls.expand((b, 1, c.hidden))?;
        let tokens = Tensor::cat(&[&cls, &frames], 1)?;
        let tokens = self.block.forward(&tokens, None, None)?;
        let read = tokens.narrow(1, 0, 1)?.squeeze(1)?.contiguous()?;
        let logit = self.head.forward(&self.norm.forward(&read)?)?;
        Ok(logit.to_dtype(DType::F32)?.squeeze(1)?)
    }
}
