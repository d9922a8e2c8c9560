//! VA-VAE f16d32, the autoencoder whose latent was aligned with a vision foundation model.
//!
//! Paper: Yao et al. 2025 (arXiv 2501.01423). Checkpoint: `vavae-imagenet256-f16d32-dinov2.pt` of
//! `hustvl/vavae-imagenet256-f16d32-dinov2`. Source: `docs/architecture.md#encoders`; upstream LightningDiT's
//! tokenizer.
//!
//! Shapes of the published size: image (N, 256, 256, 3) in 0..1, latent (N, 16, 16, 32), the mean, not
//! normalised.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::blocks::{Family, conv};
use super::naming::Naming;
use super::seam::{check_grid, to_signed, to_unit, widths};
use super::tower::{DownTower, Plan, UpTower};
use crate::cost::{self, Cost};
use crate::kinds::encoder::{Apply, EncoderConfig, apply, downsampled};
use crate::layers::Conv2d;
use crate::sizes::check_sizes;
use crate::{Loader, Result};

/// Channels of an image.
const RGB: usize = 3;
/// What else the published checkpoint holds: the training losses and the alignment with the foundation model.
const TRAINING_ONLY: [&str; 3] = ["loss.", "foundation_model.", "linear_proj."];

/// Shape of a VA-VAE. JSON example, the published one:
///
/// ```json
/// {"channels": 128, "multipliers": [1, 1, 2, 2, 4], "res_blocks": 2, "latent": 32,
///  "resolution": 256, "attention_resolutions": [16], "groups": 32}
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VaVaeConfig {
    /// Channels of the first convolution; upstream `ch`.
    pub(crate) channels: usize,
    /// Channels at each level, finest first, in multiples of `channels`; upstream `ch_mult`.
    pub(crate) multipliers: Vec<usize>,
    /// Residual blocks of an encoder level; a decoder level has one more.
    pub(crate) res_blocks: usize,
    /// Channels of the latent; upstream `z_channels` and `embed_dim`.
    pub(crate) latent: usize,
    /// Pixels along an image's side from which `attention_resolutions` are counted. Other sizes can be
    /// encoded.
    pub(crate) resolution: usize,
    /// Grid sizes at which attention follows every residual block.
    pub(crate) attention_resolutions: Vec<usize>,
    /// Groups of every group normalisation, 32 if absent.
    #[serde(default = "default_groups")]
    pub(crate) groups: usize,
}

fn default_groups() -> usize {
    32
}

impl VaVaeConfig {
    /// The published f16d32: 28.4 M parameters in the encoder, 41.4 M in the decoder.
    pub(crate) fn f16d32() -> Self {
        Self {
            channels: 128,
            multipliers: vec![1, 1, 2, 2, 4],
            res_blocks: 2,
            latent: 32,
            resolution: 256,
            attention_resolutions: vec![16],
            groups: default_groups(),
        }
    }

    /// Pixels along the side of one latent place.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub(crate) fn downsampling(&self) -> Result<usize> {
        Ok(self.plan()?.downsampling())
    }

    fn plan(&self) -> Result<Plan> {
        check_sizes(&[("latent", self.latent)])?;
        let levels = self.multipliers.len();
        let mut attending = Vec::new();
        let mut side = self.resolution;
        for level in 0..levels {
            if self.attention_resolutions.contains(&side) {
                attending.push(level);
            }
            side /= 2;
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
            attending,
            halvings: levels.saturating_sub(1),
            middle_attention: true,
        })
    }
}

impl EncoderConfig for VaVaeConfig {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(
            VaVaeEncoder::load(self, loader)?,
            VaVaeEncoder::encode,
        ))
    }

    fn features(&self, image: [usize; 2]) -> Result<[usize; 3]> {
        downsampled(image, self.downsampling()?, self.latent)
    }

    fn cost(&self) -> Result<Cost> {
        cost::va_vae_encoder(self)
    }
}

/// Images to latents. Keys `encoder.*` and `quant_conv.*`.
#[derive(Debug)]
pub(crate) struct VaVaeEncoder {
    tower: DownTower,
    quant: Conv2d,
    latent: usize,
    downsampling: usize,
    dtype: DType,
}

impl VaVaeEncoder {
    /// Loads the encoder; a decoder in the same checkpoint is passed over, as is what only training needs.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub(crate) fn load(config: &VaVaeConfig, loader: &Loader<'_>) -> Result<Self> {
        let plan = config.plan()?;
        let moments = 2 * config.latent;
        let tower = DownTower::load(&plan, RGB, moments, &loader.at("encoder"))?;
        let quant = loader.conv2d("quant_conv", conv(moments, moments, 1))?;
        for prefix in ["decoder.", "post_quant_conv."]
            .iter()
            .chain(&TRAINING_ONLY)
        {
            loader.ignore(prefix);
        }
        Ok(Self {
            tower,
            quant,
            latent: config.latent,
            downsampling: plan.downsampling(),
            dtype: loader.dtype(),
        })
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to the latent's mean (N, H / 16, W / 16, 32), f32.
    ///
    /// # Errors
    /// If `image` has another number of channels, or a size that the levels do not divide.
    pub(crate) fn encode(&self, image: &Tensor) -> Result<Tensor> {
        check_grid("image for the VA-VAE", image, RGB, self.downsampling)?;
        let x = to_signed(image)?.to_dtype(self.dtype)?;
        let moments = self.quant.forward(&self.tower.forward(&x)?)?;
        // Mean, then log-variance, which only sampling needs.
        let mean = moments.narrow(3, 0, self.latent)?;
        Ok(mean.to_dtype(DType::F32)?.contiguous()?)
    }
}

/// Latents to images. Keys `decoder.*` and `post_quant_conv.*`.
#[derive(Debug)]
pub(crate) struct VaVaeDecoder {
    quant: Conv2d,
    tower: UpTower,
    latent: usize,
    dtype: DType,
}

impl VaVaeDecoder {
    /// Loads the decoder; an encoder in the same checkpoint is passed over, as is what only training needs.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub(crate) fn load(config: &VaVaeConfig, loader: &Loader<'_>) -> Result<Self> {
        let plan = config.plan()?;
        let latent = config.latent;
        let quant = loader.conv2d("post_quant_conv", conv(latent, latent, 1))?;
        let tower = UpTower::load(&plan, latent, RGB, &loader.at("decoder"))?;
        for prefix in ["encoder.", "quant_conv."].iter().chain(&TRAINING_ONLY) {
            loader.ignore(prefix);
        }
        Ok(Self {
            quant,
            tower,
            latent,
            dtype: loader.dtype(),
        })
    }

    /// Decodes `latent` (N, h, w, 32), f32, to images (N, 16 h, 16 w, 3), f32 in 0..1.
    ///
    /// # Errors
    /// If `latent` has another shape.
    pub(crate) fn decode(&self, latent: &Tensor) -> Result<Tensor> {
        check_grid("latent for the VA-VAE", latent, self.latent, 1)?;
        let z = self.quant.forward(&latent.to_dtype(self.dtype)?)?;
        to_unit(&self.tower.forward(&z)?)
    }
}
