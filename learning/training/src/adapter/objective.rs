use anyhow::{Result, ensure};
use candle_core::Tensor;
use wm_model::Compute;
use wm_zoo::{PixelDecoder, PixelDecoderConfig, Svae, SvaeConfig};

use super::{
    AdapterRecipe, Lpips,
    feature_loss::FeatureLoss,
    files::{ADAPTER, PIXEL_DECODER},
    frames::View,
    pixel_loss::PixelLoss,
};
use crate::{fresh_weights::FreshWeights, optimiser::Variables};

/// Both networks and what each minimises.
pub(super) struct Objective<'a> {
    recipe: &'a AdapterRecipe,
    /// Steps in all.
    steps: u64,
    adapter: Svae,
    pub(super) decoder_config: PixelDecoderConfig,
    decoder: PixelDecoder,
    feature_loss: FeatureLoss,
    pixel_loss: PixelLoss<'a>,
}

/// What is minimised for some frames: by the adapter, and by the pixel decoder.
pub(super) struct Losses {
    pub adapter: Tensor,
    pub pixel: Tensor,
    /// Parts of both, by name.
    pub parts: Vec<(&'static str, f64)>,
}

impl<'a> Objective<'a> {
    /// For frames of this size, with its networks' variables at the start of a training of `steps` steps.
    pub(super) fn new(
        recipe: &'a AdapterRecipe,
        view: View,
        steps: u64,
        lpips: Option<&'a Lpips>,
        compute: &Compute,
    ) -> Result<(Self, Variables)> {
        recipe.check()?;
        let svae = recipe.svae(view.channels);
        let decoder_config = recipe.pixel_decoder();
        let factor = decoder_config.upsampling()?;
        let (height, width) = (view.rows * factor, view.columns * factor);
        ensure!(
            (height, width) == (view.height, view.width),
            "model.multipliers has {} levels, which make a picture of {height}x{width} of features of {}x{}; the frames \
             are {}x{}",
            decoder_config.multipliers.len(),
            view.rows,
            view.columns,
            view.height,
            view.width
        );
        let fresh = FreshWeights::new(recipe.seed).on(compute)?;
        let device = compute.device()?;
        let objective = Self {
            recipe,
            steps,
            adapter: Svae::load(&svae, &fresh.loader().at(ADAPTER))?,
            decoder: PixelDecoder::load(&decoder_config, &fresh.loader().at(PIXEL_DECODER))?,
            decoder_config,
            feature_loss: FeatureLoss::new(&recipe.loss, view.rows * view.columns, device)?,
            pixel_loss: PixelLoss::new(&recipe.loss, (height, width), lpips, device)?,
        };
        Ok((objective, fresh.into_variables().0))
    }

    /// The adapter's configuration.
    pub(super) fn svae(&self) -> &SvaeConfig {
        self.adapter.config()
    }

    /// Of features (N, h, w, D) and pictures (N, H, W, 3) of single views, with the noise of the latent (N, h, w, d).
    pub(super) fn losses(
        &self,
        features: &Tensor,
        pictures: &Tensor,
        noise: &Tensor,
        step: u64,
    ) -> Result<Losses> {
        let (mean, log_variance) = self.adapter.encode_distribution(features)?;
        let latent = (&mean + (&log_variance * 0.5)?.exp()?.mul(noise)?)?;
        let found = self.adapter.decode(&latent)?;
        let divergence = self.recipe.loss.divergence_at(step, self.steps);
        let (adapter, mut parts) =
            self.feature_loss
                .of(features, &found, (&mean, &log_variance), divergence)?;
        let decoded = self.decoder.decode(&mean.detach())?;
        let is_perceptual = step * self.recipe.batch as u64 >= self.recipe.loss.perceptual_after;
        let (pixel, of_pixels) = self.pixel_loss.of(&decoded, pictures, is_perceptual)?;
        parts.extend(of_pixels);
        Ok(Losses {
            adapter,
            pixel,
            parts,
        })
    }
}
