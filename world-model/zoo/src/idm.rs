//! The inverse dynamics model: which actions lie between consecutive latents.
//!
//! Paper: appendix B.6, "Inverse Dynamics Model (IDM)"; layer by layer in `docs/architecture.md#idm`. 19.839 M
//! parameters for features of 1024 and one action. It reads an encoder's native latents (those of the SD3 VAE as
//! patches of 2x2), real or predicted, and probes whether actions can be recovered from them; one model per encoder and
//! number k of actions.
//!
//! Latents lose their channels' scale (RMSNorm), are projected and given a temporal and a spatial embedding; k learned
//! queries go in front; all tokens attend to all in pre-norm blocks, and each query's output becomes an action.
//!
//! Names in the authors' release: `input_proj.*` Linear, `temporal_pos_emb` (K+1, hidden) of which the first k+1 rows
//! are used, `spatial_pos_emb` (rows * columns, hidden), `cls_queries` (k, hidden), `transformer.{i}.{norm1,norm2}.*`,
//! `transformer.{i}.attn.{qkv_proj,out_proj}.*`, `transformer.{i}.mlp.{0,3}.*`, `final_norm.*`, `head.{0,2}.*`. A file
//! without `cls_queries` is read by timm's names: `temporal_embed`, `spatial_embed`, `cls`, `blocks.{i}.attn.{qkv,proj}`,
//! `blocks.{i}.mlp.{fc1,fc2}`, `norm`.
//!
//! Configuration (JSON; all but the first two have defaults): `{"features": 1024, "horizon": 1,
//! "patch": 1, "grid": [16, 16], "hidden": 512, "depth": 6, "heads": 8, "mlp": 2048, "actions": 7}`.

mod convolutional;
mod names;
mod network;
mod trained;

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use crate::Result;
use crate::layers::{Activation, Dropout, LayerNorm, Linear, rms_norm};
use crate::loader::Loader;
use crate::sizes::{check_counts, check_multiple, check_sizes, shape_error};
use crate::vit::Block;
pub use convolutional::{ConvolutionalIdm, ConvolutionalIdmConfig};
use names::Names;
pub use network::{IdmNetwork, IdmNetworkConfig};
pub use trained::{IDM_KEY, TrainedIdm};

/// Epsilon of the input's RMSNorm, that of the transition model's.
const RMS_NORM_EPS: f64 = 1e-6;
/// Epsilon of every LayerNorm: PyTorch's default.
const LAYER_NORM_EPS: f64 = 1e-5;

/// Sizes of the inverse dynamics model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdmConfig {
    /// Channels of the latents, before patching.
    pub features: usize,
    /// Number k of actions between k + 1 latents; a checkpoint may have temporal embeddings for more.
    pub horizon: usize,
    /// Side of the patches of the latent that become tokens: 2 for the SD3 VAE, otherwise 1.
    #[serde(default = "one")]
    pub patch: usize,
    /// Rows and columns of tokens, after patching.
    #[serde(default = "default_grid")]
    pub grid: [usize; 2],
    /// Width of the tokens.
    #[serde(default = "default_hidden")]
    pub hidden: usize,
    /// Number of blocks.
    #[serde(default = "default_depth")]
    pub depth: usize,
    /// Attention heads.
    #[serde(default = "default_heads")]
    pub heads: usize,
    /// Hidden width of the feed-forward networks; four times `hidden` if it is not given.
    #[serde(default)]
    pub mlp: Option<usize>,
    /// Components of an action.
    #[serde(default = "default_actions")]
    pub actions: usize,
}

fn one() -> usize {
    1
}

fn default_grid() -> [usize; 2] {
    [16, 16]
}

fn default_hidden() -> usize {
    512
}

fn default_depth() -> usize {
    6
}

fn default_heads() -> usize {
    8
}

fn default_actions() -> usize {
    7
}

impl IdmConfig {
    /// The paper's, for latents of 16x16 tokens with this many channels.
    pub fn paper(features: usize, horizon: usize) -> Self {
        Self {
            features,
            horizon,
            patch: one(),
            grid: default_grid(),
            hidden: default_hidden(),
            depth: default_depth(),
            heads: default_heads(),
            mlp: None,
            actions: default_actions(),
        }
    }

    /// The paper's, for latents 32x32x16 of the SD3 VAE.
    pub fn sd3(horizon: usize) -> Self {
        Self {
            patch: 2,
            ..Self::paper(16, horizon)
        }
    }

    /// Hidden width of the feed-forward networks.
    pub(crate) fn mlp_width(&self) -> usize {
        self.mlp.unwrap_or(4 * self.hidden)
    }

    fn validate(&self) -> Result<()> {
        let [rows, columns] = self.grid;
        check_sizes(&[
            ("features", self.features),
            ("horizon", self.horizon),
            ("patch", self.patch),
            ("grid", rows),
            ("grid", columns),
            ("hidden", self.hidden),
            ("heads", self.heads),
            ("mlp", self.mlp.unwrap_or(1)),
            ("actions", self.actions),
        ])?;
        check_counts(&[("depth", self.depth)])?;
        check_multiple(("hidden", self.hidden), ("heads", self.heads))
    }
}

/// The inverse dynamics model.
#[derive(Clone, Debug)]
pub struct Idm {
    config: IdmConfig,
    input: Linear,
    /// (1, frames, 1, hidden).
    temporal: Tensor,
    /// (1, 1, tokens, hidden).
    spatial: Tensor,
    /// (1, horizon, hidden).
    queries: Tensor,
    blocks: Vec<Block>,
    norm: LayerNorm,
    head: [Linear; 2],
}

impl Idm {
    /// Loads the model.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &IdmConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        let (width, frames) = (config.hidden, config.horizon + 1);
        let [rows, columns] = config.grid;
        let tokens = rows * columns;
        let inputs = config.features * config.patch * config.patch;
        let names = Names::of(loader);
        // The authors' embedding has a row for each frame of the longest horizon that they trained together.
        let rows = loader.shape(names.temporal).and_then(|shape| shape.first());
        let rows = rows.map_or(frames, |rows| frames.max(*rows));
        let temporal = loader.tensor(names.temporal, &[rows, width])?;
        let temporal = temporal.narrow(0, 0, frames)?.contiguous()?;
        let spatial = loader.tensor(names.spatial, &[tokens, width])?;
        let blocks = loader.at(names.blocks);
        Ok(Self {
            config: config.clone(),
            input: loader.sensitive().linear("input_proj", inputs, width)?,
            temporal: temporal.reshape((1, frames, 1, width))?,
            spatial: spatial.reshape((1, 1, tokens, width))?,
            queries: loader
                .tensor(names.queries, &[config.horizon, width])?
                .unsqueeze(0)?,
            blocks: (0..config.depth)
                .map(|i| {
                    let sizes = (width, config.heads, config.mlp_width());
                    Block::load(&blocks.at(i), &names.block, sizes, LAYER_NORM_EPS)
                })
                .collect::<Result<_>>()?,
            norm: loader.layer_norm(names.norm, width, LAYER_NORM_EPS)?,
            head: [
                loader.sensitive().linear("head.0", width, width)?,
                loader.sensitive().linear("head.2", width, config.actions)?,
            ],
        })
    }

    /// The configuration.
    pub fn config(&self) -> &IdmConfig {
        &self.config
    }

    /// Latents (B, horizon + 1, h, w, features) to the actions between them (B, horizon, actions),
    /// f32, in the normalised units that the model was trained on.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward(&self, latents: &Tensor) -> Result<Tensor> {
        self.forward_dropping(latents, &mut Dropout::none())
    }

    /// The same in training, with dropout in its blocks (the paper: 0.1).
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward_dropping(&self, latents: &Tensor, dropout: &mut Dropout<'_>) -> Result<Tensor> {
        let [first, second] = &self.head;
        let answers = self.answers(latents, dropout)?;
        let hidden = first.forward_activated(&answers, Activation::GeluExact)?;
        Ok(second.forward(&hidden)?.to_dtype(DType::F32)?)
    }

    /// Latents (B, horizon + 1, h, w, features) to what the head reads: a feature of each action (B, horizon, hidden), f32.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn features(&self, latents: &Tensor) -> Result<Tensor> {
        let answers = self.answers(latents, &mut Dropout::none())?;
        Ok(answers.to_dtype(DType::F32)?)
    }

    /// The normed outputs of the queries (B, horizon, hidden).
    fn answers(&self, latents: &Tensor, dropout: &mut Dropout<'_>) -> Result<Tensor> {
        let latents = latents.to_device(self.queries.device())?;
        let patches = self.patches(&latents.to_dtype(self.queries.dtype())?)?;
        let (b, frames, tokens, _) = patches.dims4()?;
        let (k, width) = (self.config.horizon, self.config.hidden);
        let x = self
            .input
            .forward(&rms_norm(&patches, RMS_NORM_EPS)?)?
            .broadcast_add(&self.temporal)?
            .broadcast_add(&self.spatial)?
            .reshape((b, frames * tokens, width))?;
        let queries = self.queries.expand((b, k, width))?;
        let mut x = Tensor::cat(&[&queries, &x], 1)?;
        for block in &self.blocks {
            x = block.forward_dropping(&x, None, None, dropout)?;
        }
        self.norm.forward(&x.narrow(1, 0, k)?.contiguous()?)
    }

    /// (B, frames, h, w, C) to (B, frames, tokens, patch * patch * C), a patch's values in the
    /// order row, column, channel.
    fn patches(&self, latents: &Tensor) -> Result<Tensor> {
        let c = &self.config;
        let ([rows, columns], p, frames) = (c.grid, c.patch, c.horizon + 1);
        let expected = [frames, rows * p, columns * p, c.features];
        let b = match latents.dims() {
            &[b, ..] if latents.dims().get(1..) == Some(&expected) => b,
            _ => {
                let [t, h, w, channels] = expected;
                let expected = format!("(B, {t}, {h}, {w}, {channels})");
                return Err(shape_error("the latents", expected, latents));
            }
        };
        let split = latents
            .reshape((b * frames * rows, p, columns, p * c.features))?
            .transpose(1, 2)?
            .contiguous()?;
        Ok(split.reshape((b, frames, rows * columns, p * p * c.features))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::Kernels;

    #[test]
    fn the_papers_has_the_published_size() {
        let loader = Loader::skeleton(Kernels::Candle);
        Idm::load(&IdmConfig::paper(1024, 1), &loader).unwrap();
        assert_eq!(loader.parameters(), 19_838_983);
        // Three more actions: three queries and three temporal embeddings.
        let loader = Loader::skeleton(Kernels::Candle);
        Idm::load(&IdmConfig::paper(1024, 4), &loader).unwrap();
        assert_eq!(loader.parameters(), 19_838_983 + 6 * 512);
    }

    fn small(patch: usize) -> IdmConfig {
        IdmConfig {
            patch,
            grid: [2, 3],
            hidden: 16,
            depth: 2,
            heads: 2,
            actions: 5,
            ..IdmConfig::paper(4, 3)
        }
    }

    #[test]
    fn a_small_one_has_the_shape_of_its_configuration() {
        for patch in [1, 2] {
            let loader = Loader::skeleton(Kernels::Candle);
            let model = Idm::load(&small(patch), &loader).unwrap();
            let shape = (2, 4, 2 * patch, 3 * patch, 4);
            let latents = Tensor::ones(shape, DType::F32, &Device::Cpu).unwrap();
            assert_eq!(model.forward(&latents).unwrap().dims(), [2, 3, 5]);
            assert_eq!(model.features(&latents).unwrap().dims(), [2, 3, 16]);
            let message = model.forward(&latents.narrow(1, 0, 3).unwrap());
            let message = message.unwrap_err().to_string();
            assert!(message.contains("(B, 4,"), "{message}");
        }
    }

    #[test]
    fn patches_are_in_the_order_row_column_channel() {
        let config = IdmConfig {
            features: 1,
            horizon: 1,
            grid: [1, 2],
            ..small(2)
        };
        let model = Idm::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap();
        let values = Tensor::arange(0.0_f32, 16.0, &Device::Cpu).unwrap();
        let patches = model.patches(&values.reshape((1, 2, 2, 4, 1)).unwrap());
        let first = patches.unwrap().narrow(1, 0, 1).unwrap().flatten_all();
        let first = first.unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(first, [0.0, 1.0, 4.0, 5.0, 2.0, 3.0, 6.0, 7.0]);
    }

    #[test]
    fn a_configuration_may_be_short() {
        let config: IdmConfig =
            serde_json::from_str(r#"{"features": 1152, "horizon": 4}"#).unwrap();
        assert_eq!(config, IdmConfig::paper(1152, 4));
    }
}
