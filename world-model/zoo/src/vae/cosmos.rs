//! Cosmos-CI16x16, NVIDIA's continuous image tokenizer.
//!
//! Paper: Agarwal et al. 2025 (arXiv 2501.03575). Checkpoint: `nvidia/Cosmos-0.1-Tokenizer-CI16x16`. Source:
//! `docs/architecture.md#encoders`; upstream `layers2d.py` of NVIDIA/Cosmos-Tokenizer. diffusers'
//! `AutoencoderKLCosmos` is the video tokenizer, another network.
//!
//! Shapes of the published size: image (N, 256, 256, 3) in 0..1; Haar patches (N, 64, 64, 48) of pixels that
//! were moved to -1..1; latent (N, 16, 16, 16), deterministic, not scaled.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::blocks::{Family, conv};
use super::haar;
use super::naming::Naming;
use super::seam::{check_grid, config_error, to_signed, to_unit, widths};
use super::tower::{DownTower, Plan, UpTower};
use crate::cost::{self, Cost};
use crate::kinds::encoder::{Apply, EncoderConfig, apply, downsampled};
use crate::layers::Conv2d;
use crate::sizes::check_sizes;
use crate::{Loader, Result};

/// Channels of an image.
const RGB: usize = 3;
/// More Haar levels than this are a mistake: each takes four times the channels.
const MAX_HAAR_LEVELS: u32 = 4;

/// Shape of a Cosmos image tokenizer. JSON example, the published CI16x16:
///
/// ```json
/// {"channels": 128, "multipliers": [2, 4, 4], "res_blocks": 2, "latent": 16,
///  "patch": 4, "compression": 16, "groups": 32}
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CosmosConfig {
    /// Channels of the first convolution.
    pub(crate) channels: usize,
    /// Channels at each level, finest first, in multiples of `channels`; upstream `channels_mult`.
    pub(crate) multipliers: Vec<usize>,
    /// Residual blocks of an encoder level; a decoder level has one more.
    pub(crate) res_blocks: usize,
    /// Channels of the latent.
    pub(crate) latent: usize,
    /// Side of a Haar patch in pixels, a power of two; upstream `patch_size`.
    pub(crate) patch: usize,
    /// Pixels along the side of one latent place, a power of two; upstream `spatial_compression`.
    pub(crate) compression: usize,
    /// Groups of every group normalisation, 32 if absent.
    #[serde(default = "default_groups")]
    pub(crate) groups: usize,
}

fn default_groups() -> usize {
    32
}

impl CosmosConfig {
    /// The published CI16x16: 33.5 M parameters in the encoder, 48.0 M in the decoder.
    pub(crate) fn ci16x16() -> Self {
        Self {
            channels: 128,
            multipliers: vec![2, 4, 4],
            res_blocks: 2,
            latent: 16,
            patch: 4,
            compression: 16,
            groups: default_groups(),
        }
    }

    fn haar_levels(&self) -> Result<u32> {
        if !self.patch.is_power_of_two() || self.patch.ilog2() > MAX_HAAR_LEVELS {
            return Err(config_error(
                "patch",
                format!(
                    "{}: expected a power of two, at most {}",
                    self.patch,
                    1 << MAX_HAAR_LEVELS
                ),
            ));
        }
        Ok(self.patch.ilog2())
    }

    fn plan(&self) -> Result<Plan> {
        check_sizes(&[("latent", self.latent)])?;
        let patch_levels = self.haar_levels()? as usize;
        if !self.compression.is_power_of_two() || self.compression < self.patch {
            return Err(config_error(
                "compression",
                format!(
                    "{}: expected a power of two, at least the patch, {}",
                    self.compression, self.patch
                ),
            ));
        }
        Ok(Plan {
            family: Family {
                naming: Naming::LatentDiffusion,
                groups: self.groups,
                heads: 1,
            },
            widths_field: "multipliers",
            stem: self.channels,
            widths: widths(self.channels, &self.multipliers),
            res_blocks: self.res_blocks,
            attending: Vec::new(),
            halvings: self.compression.ilog2() as usize - patch_levels,
            middle_attention: true,
        })
    }

    /// Channels of the Haar patches.
    fn patch_channels(&self) -> usize {
        RGB * self.patch * self.patch
    }
}

impl EncoderConfig for CosmosConfig {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(
            CosmosEncoder::load(self, loader)?,
            CosmosEncoder::encode,
        ))
    }

    fn features(&self, image: [usize; 2]) -> Result<[usize; 3]> {
        downsampled(image, self.compression, self.latent)
    }

    fn cost(&self) -> Result<Cost> {
        cost::cosmos_encoder(self)
    }
}

/// Images to latents. Keys `encoder.*` and `quant_conv.*`.
#[derive(Debug)]
pub(crate) struct CosmosEncoder {
    tower: DownTower,
    quant: Conv2d,
    haar_levels: u32,
    compression: usize,
    dtype: DType,
}

impl CosmosEncoder {
    /// Loads the encoder; a decoder in the same checkpoint is passed over.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub(crate) fn load(config: &CosmosConfig, loader: &Loader<'_>) -> Result<Self> {
        let plan = config.plan()?;
        let latent = config.latent;
        let inputs = config.patch_channels();
        let tower = DownTower::load(&plan, inputs, latent, &loader.at("encoder"))?;
        let quant = loader.conv2d("quant_conv", conv(latent, latent, 1))?;
        // The wavelet itself is a buffer in some exports.
        for prefix in ["decoder.", "post_quant_conv.", "encoder.patcher."] {
            loader.ignore(prefix);
        }
        Ok(Self {
            tower,
            quant,
            haar_levels: config.haar_levels()?,
            compression: config.compression,
            dtype: loader.dtype(),
        })
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to the latent (N, H / 16, W / 16, 16), f32.
    ///
    /// # Errors
    /// If `image` has another number of channels, or a size that the compression does not divide.
    pub(crate) fn encode(&self, image: &Tensor) -> Result<Tensor> {
        check_grid("image for Cosmos", image, RGB, self.compression)?;
        let mut x = to_signed(image)?;
        for _ in 0..self.haar_levels {
            x = haar::split(&x)?;
        }
        let hidden = self.tower.forward(&x.to_dtype(self.dtype)?)?;
        Ok(self.quant.forward(&hidden)?.to_dtype(DType::F32)?)
    }
}

/// Latents to images. Keys `decoder.*` and `post_quant_conv.*`.
#[derive(Debug)]
pub(crate) struct CosmosDecoder {
    quant: Conv2d,
    tower: UpTower,
    haar_levels: u32,
    latent: usize,
    dtype: DType,
}

impl CosmosDecoder {
    /// Loads the decoder; an encoder in the same checkpoint is passed over.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub(crate) fn load(config: &CosmosConfig, loader: &Loader<'_>) -> Result<Self> {
        let plan = config.plan()?;
        let latent = config.latent;
        let quant = loader.conv2d("post_quant_conv", conv(latent, latent, 1))?;
        let outputs = config.patch_channels();
        let tower = UpTower::load(&plan, latent, outputs, &loader.at("decoder"))?;
        // The wavelet itself is a buffer in some exports.
        for prefix in ["encoder.", "quant_conv.", "decoder.unpatcher."] {
            loader.ignore(prefix);
        }
        Ok(Self {
            quant,
            tower,
            haar_levels: config.haar_levels()?,
            latent,
            dtype: loader.dtype(),
        })
    }

    /// Decodes `latent` (N, h, w, 16), f32, to images (N, 16 h, 16 w, 3), f32 in 0..1.
    ///
    /// # Errors
    /// If `latent` has another shape.
    pub(crate) fn decode(&self, latent: &Tensor) -> Result<Tensor> {
        check_grid("latent for Cosmos", latent, self.latent, 1)?;
        let z = self.quant.forward(&latent.to_dtype(self.dtype)?)?;
        let mut x = self.tower.forward(&z)?.to_dtype(DType::F32)?;
        for _ in 0..self.haar_levels {
            x = haar::join(&x)?;
        }
        to_unit(&x)
    }
}
