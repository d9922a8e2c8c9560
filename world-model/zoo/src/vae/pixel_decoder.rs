//! The paper's pixel decoder: latents of the S-VAE adapter to images.
//!
//! Source: the paper, appendix B.4, and `docs/architecture.md#pixel-decoder`. Checkpoint: `pixel_decoder` of the adapter's, key names as written
//! there.
//!
//! Shapes of the published size: latent (N, 16, 16, 96), image (N, 256, 256, 3) in 0..1 through a sigmoid.
//! Inside, from the coarsest level: 1280 channels at 16x16, 640 at 32x32, 320 at 64x64, 160 at 128x128, 160
//! at 256x256.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::blocks::{Family, Level, Middle, Output, Upsample, conv};
use super::naming::Naming;
use super::seam::{check_grid, check_widths, config_error, widths};
use crate::layers::Conv2d;
use crate::sizes::{check_counts, check_sizes};
use crate::{Loader, Result};

/// Channels of an image.
const RGB: usize = 3;
/// Groups of every group normalisation (fewer where there are fewer channels).
const GROUPS: usize = 32;
/// More levels than this are a mistake: the image would be 2^16 times the latent.
const MAX_LEVELS: usize = 16;

/// Shape of a pixel decoder. JSON example, the paper's:
///
/// ```json
/// {"latent": 96, "base": 160, "multipliers": [1, 1, 2, 4, 8], "res_blocks": 2, "heads": 4}
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PixelDecoderConfig {
    /// Channels of the latent.
    pub latent: usize,
    /// Channels that the multipliers count in; from 32 channels on, a level's must be a multiple of 32.
    pub base: usize,
    /// Channels at each level, finest first, in multiples of `base`.
    pub multipliers: Vec<usize>,
    /// Residual blocks of a level.
    pub res_blocks: usize,
    /// Heads of both attentions.
    pub heads: usize,
}

impl PixelDecoderConfig {
    /// The paper's, 177.0 M parameters.
    pub fn paper() -> Self {
        Self {
            latent: 96,
            base: 160,
            multipliers: vec![1, 1, 2, 4, 8],
            res_blocks: 2,
            heads: 4,
        }
    }

    /// Pixels along the side of one latent place.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub fn upsampling(&self) -> Result<usize> {
        self.check()?;
        Ok(1 << self.multipliers.len().saturating_sub(1))
    }

    /// Channels at each level in running order, coarsest first.
    fn widths(&self) -> Vec<usize> {
        let mut widths = widths(self.base, &self.multipliers);
        widths.reverse();
        widths
    }

    fn check(&self) -> Result<()> {
        let levels = self.multipliers.len();
        if levels > MAX_LEVELS {
            return Err(config_error(
                "multipliers",
                format!("{levels} levels, expected at most {MAX_LEVELS}"),
            ));
        }
        let widths = self.widths();
        check_widths("multipliers", &widths, GROUPS, 1)?;
        // The line above refuses empty widths.
        check_widths("heads", widths.get(..1).unwrap_or(&[]), GROUPS, self.heads)?;
        check_sizes(&[("latent", self.latent)])?;
        check_counts(&[("res_blocks", self.res_blocks)])
    }
}

/// Latents to images.
#[derive(Debug)]
pub struct PixelDecoder {
    proj_in: Conv2d,
    middle: Middle,
    /// Coarsest first; all but the last end with a doubling.
    levels: Vec<(Level, Option<Upsample>)>,
    output: Output,
    latent: usize,
    dtype: DType,
}

impl PixelDecoder {
    /// Loads the decoder.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub fn load(config: &PixelDecoderConfig, loader: &Loader<'_>) -> Result<Self> {
        config.check()?;
        let naming = Naming::Pixel;
        let family = Family {
            naming,
            groups: GROUPS,
            heads: config.heads,
        };
        let widths = config.widths();
        let Some(mut before) = widths.first().copied() else {
            return Err(config_error("multipliers", "no level".to_owned()));
        };
        let proj_in = loader.conv2d(naming.conv_in(), conv(config.latent, before, 1))?;
        let middle = Middle::load(family, before, true, loader)?;
        let last_block = config.res_blocks - 1;
        let mut levels = Vec::with_capacity(widths.len());
        for (order, width) in widths.iter().copied().enumerate() {
            let finer = widths.len() - 1 - order;
            let loader = loader.at(naming.up(finer, widths.len()));
            let attends = |block| order == 0 && block == last_block;
            let channels = (before, width);
            let level = Level::load(family, channels, config.res_blocks, attends, &loader)?;
            let upsample = (finer > 0)
                .then(|| Upsample::load(family, width, &loader))
                .transpose()?;
            levels.push((level, upsample));
            before = width;
        }
        Ok(Self {
            proj_in,
            middle,
            levels,
            output: Output::load(family, before, RGB, loader)?,
            latent: config.latent,
            dtype: loader.dtype(),
        })
    }

    /// Decodes `latent` (N, h, w, 96), f32, to images (N, 16 h, 16 w, 3), f32 in 0..1.
    ///
    /// # Errors
    /// If `latent` has another shape.
    pub fn decode(&self, latent: &Tensor) -> Result<Tensor> {
        check_grid("latent for the pixel decoder", latent, self.latent, 1)?;
        let x = self.proj_in.forward(&latent.to_dtype(self.dtype)?)?;
        let mut x = self.middle.forward(&x)?;
        for (level, upsample) in &self.levels {
            x = level.forward(&x)?;
            if let Some(upsample) = upsample {
                x = upsample.forward(&x)?;
            }
        }
        let x = self.output.forward(&x)?.to_dtype(DType::F32)?;
        // 1 / (1 + exp(-x)); exp overflows to infinity for x below -88, which gives the right 0.
        Ok((x.neg()?.exp()? + 1.0)?.recip()?)
    }
}
