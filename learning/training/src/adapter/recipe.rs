use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_zoo::{PixelDecoderConfig, SvaeConfig};

use crate::recipe::recipe;

recipe! {
    /// Settings of adapter training, explained in `recipes/*/adapter.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct AdapterRecipe in ["tiny", "paper"] of "adapter" {
        pub views: usize,
        pub pixel_decoder_rate: f64,
        pub model: AdapterModelRecipe,
        pub loss: LossRecipe,
    }
}

/// Shape of both networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct AdapterModelRecipe {
    pub latent: usize,
    pub heads: usize,
    pub layers: usize,
    pub ffn: usize,
    pub base: usize,
    pub multipliers: Vec<usize>,
    pub res_blocks: usize,
    pub pixel_heads: usize,
}

/// Weights of the terms of both losses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct LossRecipe {
    pub cosine: f64,
    pub spectrum: f64,
    pub kl: f64,
    pub kl_warm_up: f64,
    pub pixel: f64,
    pub lpips: f64,
    pub ms_ssim: f64,
    pub perceptual_after: u64,
}

impl AdapterRecipe {
    pub(super) fn check(&self) -> Result<()> {
        crate::recipe::check_batch(self.batch, self.micro_batch)?;
        let loss = &self.loss;
        let part = loss.kl_warm_up;
        ensure!(
            (0.0..=1.0).contains(&part),
            "loss.kl_warm_up is {part}, expected 0 to 1"
        );
        for (name, weight) in [
            ("cosine", loss.cosine),
            ("spectrum", loss.spectrum),
            ("kl", loss.kl),
            ("lpips", loss.lpips),
            ("ms_ssim", loss.ms_ssim),
        ] {
            ensure!(
                weight >= 0.0 && weight.is_finite(),
                "loss.{name} is {weight}, expected 0 or more"
            );
        }
        // The pixel decoder has no other loss.
        ensure!(
            loss.pixel > 0.0 && loss.pixel.is_finite(),
            "loss.pixel is {}, expected more than 0",
            loss.pixel
        );
        Ok(())
    }

    /// The adapter for this number of feature channels; loading checks it.
    #[must_use]
    pub fn svae(&self, features: usize) -> SvaeConfig {
        let own = &self.model;
        SvaeConfig {
            features,
            latent: own.latent,
            heads: own.heads,
            layers: own.layers,
            ffn: own.ffn,
        }
    }

    /// The pixel decoder; loading checks it.
    #[must_use]
    pub fn pixel_decoder(&self) -> PixelDecoderConfig {
        let own = &self.model;
        PixelDecoderConfig {
            latent: own.latent,
            base: own.base,
            multipliers: own.multipliers.clone(),
            res_blocks: own.res_blocks,
            heads: own.pixel_heads,
        }
    }
}

impl LossRecipe {
    /// Weight of the latent's divergence at `step` of `steps`.
    pub(super) fn divergence_at(&self, step: u64, steps: u64) -> f64 {
        let warm_up = self.kl_warm_up * steps as f64;
        match warm_up > step as f64 {
            true => self.kl * step as f64 / warm_up,
            false => self.kl,
        }
    }
}
