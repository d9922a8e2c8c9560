//! The autoencoder of Stable Diffusion 3.
//!
//! Paper: Esser et al. 2024 (arXiv 2403.03206). Checkpoint: the `vae` folder of
//! `stabilityai/stable-diffusion-3-medium-diffusers`, whose `config.json` is read as it is. Source:
//! `docs/architecture.md#encoders`; upstream diffusers' `AutoencoderKL`, whose other checkpoints (with
//! `quant_conv`, other widths) are read too as long as they have plain down and up blocks.
//!
//! Shapes of the published size: image (N, 256, 256, 3) in 0..1, latent (N, 32, 32, 16).
//!
//! # Scale of the latent
//!
//! The library's convention is z = (mean - `shift_factor`) * `scaling_factor`, 0.0609 and 1.5305 in SD3's
//! config. It is applied by the encoder and undone by the decoder when the config states both values. A
//! config without `shift_factor` is not of this family and says nothing of such a convention: its latent is
//! the plain mean. The reference implementation of the paper multiplies and does not subtract: for its
//! checkpoints write `"shift_factor": 0.0` into the config. A key of our own, `"apply_scaling"`, true or
//! false, overrides all this.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::blocks::{Family, conv};
use super::naming::Naming;
use super::seam::{check_grid, config_error, to_signed, to_unit};
use super::tower::{DownTower, Plan, UpTower};
use crate::cost::{self, Cost};
use crate::kinds::encoder::{Apply, EncoderConfig, apply, downsampled};
use crate::layers::Conv2d;
use crate::sizes::check_sizes;
use crate::{Loader, Result};

/// The only kind of encoder level that is known here.
const DOWN_BLOCK: &str = "DownEncoderBlock2D";
/// The only kind of decoder level that is known here.
const UP_BLOCK: &str = "UpDecoderBlock2D";

/// diffusers' `AutoencoderKL` configuration; keys of it that change nothing here are passed over, and what is
/// absent has diffusers' default (but no scale or shift, see the [module](self)).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct SdVaeConfig {
    /// Channels of the image that is encoded.
    pub(crate) in_channels: usize,
    /// Channels of the image that is decoded.
    pub(crate) out_channels: usize,
    /// Kind of each encoder level.
    pub(crate) down_block_types: Vec<String>,
    /// Kind of each decoder level.
    pub(crate) up_block_types: Vec<String>,
    /// Channels at each level, finest first.
    pub(crate) block_out_channels: Vec<usize>,
    /// Residual blocks of an encoder level; a decoder level has one more.
    pub(crate) layers_per_block: usize,
    /// Activation.
    pub(crate) act_fn: String,
    /// Channels of the latent.
    pub(crate) latent_channels: usize,
    /// Groups of every group normalisation.
    pub(crate) norm_num_groups: usize,
    /// Factor of the latent's scale.
    pub(crate) scaling_factor: Option<f64>,
    /// What is subtracted from the mean before.
    pub(crate) shift_factor: Option<f64>,
    /// Whether a 1x1 convolution follows the encoder.
    pub(crate) use_quant_conv: bool,
    /// Whether a 1x1 convolution precedes the decoder.
    pub(crate) use_post_quant_conv: bool,
    /// Whether the middle has attention.
    pub(crate) mid_block_add_attention: bool,
    /// Ours, not diffusers': whether scale and shift are applied; see the [module](self) for what happens
    /// without it.
    pub(crate) apply_scaling: Option<bool>,
}

impl Default for SdVaeConfig {
    fn default() -> Self {
        Self {
            in_channels: 3,
            out_channels: 3,
            down_block_types: vec![DOWN_BLOCK.to_owned()],
            up_block_types: vec![UP_BLOCK.to_owned()],
            block_out_channels: vec![64],
            layers_per_block: 1,
            act_fn: "silu".to_owned(),
            latent_channels: 4,
            norm_num_groups: 32,
            scaling_factor: None,
            shift_factor: None,
            use_quant_conv: true,
            use_post_quant_conv: true,
            mid_block_add_attention: true,
            apply_scaling: None,
        }
    }
}

impl SdVaeConfig {
    /// Stable Diffusion 3: 34.3 M parameters in the encoder, 49.5 M in the decoder.
    pub(crate) fn sd3() -> Self {
        Self {
            down_block_types: vec![DOWN_BLOCK.to_owned(); 4],
            up_block_types: vec![UP_BLOCK.to_owned(); 4],
            block_out_channels: vec![128, 256, 512, 512],
            layers_per_block: 2,
            latent_channels: 16,
            scaling_factor: Some(1.5305),
            shift_factor: Some(0.0609),
            use_quant_conv: false,
            use_post_quant_conv: false,
            ..Self::default()
        }
    }

    /// Scale and shift of the latent, if they are applied.
    ///
    /// # Errors
    /// If the scale cannot be undone, or a value is not finite.
    pub(crate) fn scale_and_shift(&self) -> Result<Option<(f64, f64)>> {
        let stated = self.scaling_factor.is_some() && self.shift_factor.is_some();
        if !self.apply_scaling.unwrap_or(stated) {
            return Ok(None);
        }
        let scale = self.scaling_factor.unwrap_or(1.0);
        let shift = self.shift_factor.unwrap_or(0.0);
        if !scale.is_finite() || scale == 0.0 {
            return Err(config_error(
                "scaling_factor",
                format!("{scale}: expected a finite number that is not 0"),
            ));
        }
        if !shift.is_finite() {
            return Err(config_error(
                "shift_factor",
                format!("{shift}: expected a finite number"),
            ));
        }
        Ok(Some((scale, shift)))
    }

    /// Pixels along the side of one latent place.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub(crate) fn downsampling(&self) -> Result<usize> {
        Ok(self.plan()?.downsampling())
    }

    fn plan(&self) -> Result<Plan> {
        let levels = self.block_out_channels.len();
        for (field, kinds, known) in [
            ("down_block_types", &self.down_block_types, DOWN_BLOCK),
            ("up_block_types", &self.up_block_types, UP_BLOCK),
        ] {
            if kinds.len() != levels || kinds.iter().any(|kind| kind != known) {
                return Err(config_error(
                    field,
                    format!("{kinds:?}: expected {levels} times {known}"),
                ));
            }
        }
        if !matches!(self.act_fn.as_str(), "silu" | "swish") {
            return Err(config_error(
                "act_fn",
                format!("{}: expected silu", self.act_fn),
            ));
        }
        check_sizes(&[
            ("in_channels", self.in_channels),
            ("out_channels", self.out_channels),
            ("latent_channels", self.latent_channels),
        ])?;
        Ok(Plan {
            family: Family {
                naming: Naming::Diffusers,
                groups: self.norm_num_groups,
                heads: 1,
            },
            widths_field: "block_out_channels",
            // `Plan::check` refuses a width of 0.
            stem: self.block_out_channels.first().copied().unwrap_or(0),
            widths: self.block_out_channels.clone(),
            res_blocks: self.layers_per_block,
            attending: Vec::new(),
            halvings: levels.saturating_sub(1),
            middle_attention: self.mid_block_add_attention,
        })
    }
}

impl EncoderConfig for SdVaeConfig {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(
            SdVaeEncoder::load(self, loader)?,
            SdVaeEncoder::encode,
        ))
    }

    fn features(&self, image: [usize; 2]) -> Result<[usize; 3]> {
        downsampled(image, self.downsampling()?, self.latent_channels)
    }

    fn cost(&self) -> Result<Cost> {
        cost::sd3_encoder(self)
    }
}

/// Images to latents. Keys `encoder.*` and, where the config has it, `quant_conv.*`.
#[derive(Debug)]
pub(crate) struct SdVaeEncoder {
    tower: DownTower,
    quant: Option<Conv2d>,
    scale_and_shift: Option<(f64, f64)>,
    image_channels: usize,
    latent_channels: usize,
    downsampling: usize,
    dtype: DType,
}

impl SdVaeEncoder {
    /// Loads the encoder; a decoder in the same checkpoint is passed over.
    ///
    /// # Errors
    /// If the configuration is invalid or names a block that is not known here.
    pub(crate) fn load(config: &SdVaeConfig, loader: &Loader<'_>) -> Result<Self> {
        let plan = config.plan()?;
        let moments = 2 * config.latent_channels;
        let tower = DownTower::load(&plan, config.in_channels, moments, &loader.at("encoder"))?;
        let quant = config
            .use_quant_conv
            .then(|| loader.conv2d("quant_conv", conv(moments, moments, 1)))
            .transpose()?;
        loader.ignore("decoder.");
        loader.ignore("post_quant_conv.");
        Ok(Self {
            tower,
            quant,
            scale_and_shift: config.scale_and_shift()?,
            image_channels: config.in_channels,
            latent_channels: config.latent_channels,
            downsampling: plan.downsampling(),
            dtype: loader.dtype(),
        })
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to the latent (N, H / 8, W / 8, 16), f32, scaled as the
    /// config says.
    ///
    /// # Errors
    /// If `image` has another number of channels, or a size that the levels do not divide.
    pub(crate) fn encode(&self, image: &Tensor) -> Result<Tensor> {
        check_grid(
            "image for the SD3 VAE",
            image,
            self.image_channels,
            self.downsampling,
        )?;
        let x = to_signed(image)?.to_dtype(self.dtype)?;
        let mut moments = self.tower.forward(&x)?;
        if let Some(quant) = &self.quant {
            moments = quant.forward(&moments)?;
        }
        // Mean, then log-variance, which only sampling needs.
        let mean = moments.narrow(3, 0, self.latent_channels)?;
        let mean = mean.to_dtype(DType::F32)?.contiguous()?;
        Ok(match self.scale_and_shift {
            Some((scale, shift)) => mean.affine(scale, -shift * scale)?,
            None => mean,
        })
    }
}

/// Latents to images. Keys `decoder.*` and, where the config has it, `post_quant_conv.*`.
#[derive(Debug)]
pub(crate) struct SdVaeDecoder {
    tower: UpTower,
    quant: Option<Conv2d>,
    scale_and_shift: Option<(f64, f64)>,
    latent_channels: usize,
    dtype: DType,
}

impl SdVaeDecoder {
    /// Loads the decoder; an encoder in the same checkpoint is passed over.
    ///
    /// # Errors
    /// If the configuration is invalid or names a block that is not known here.
    pub(crate) fn load(config: &SdVaeConfig, loader: &Loader<'_>) -> Result<Self> {
        let plan = config.plan()?;
        let latent = config.latent_channels;
        let quant = config
            .use_post_quant_conv
            .then(|| loader.conv2d("post_quant_conv", conv(latent, latent, 1)))
            .transpose()?;
        let tower = UpTower::load(&plan, latent, config.out_channels, &loader.at("decoder"))?;
        loader.ignore("encoder.");
        loader.ignore("quant_conv.");
        Ok(Self {
            tower,
            quant,
            scale_and_shift: config.scale_and_shift()?,
            latent_channels: latent,
            dtype: loader.dtype(),
        })
    }

    /// Decodes `latent` (N, h, w, 16), f32, scaled as the config says, to images (N, 8 h, 8 w, 3), f32 in
    /// 0..1.
    ///
    /// # Errors
    /// If `latent` has another shape.
    pub(crate) fn decode(&self, latent: &Tensor) -> Result<Tensor> {
        check_grid("latent for the SD3 VAE", latent, self.latent_channels, 1)?;
        let mut z = latent.to_dtype(DType::F32)?;
        if let Some((scale, shift)) = self.scale_and_shift {
            z = z.affine(scale.recip(), shift)?;
        }
        let mut z = z.to_dtype(self.dtype)?;
        if let Some(quant) = &self.quant {
            z = quant.forward(&z)?;
        }
        to_unit(&self.tower.forward(&z)?)
    }
}
