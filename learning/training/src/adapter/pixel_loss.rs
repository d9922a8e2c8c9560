//! Loss of the pixel decoder.

use anyhow::Result;
use candle_core::{Device, Tensor};

use super::{LossRecipe, Lpips, MsSsim, feature_loss::weighted};

/// Squared error and, later, LPIPS and MS-SSIM.
pub(super) struct PixelLoss<'a> {
    weight: f64,
    lpips: Option<(f64, &'a Lpips)>,
    ms_ssim: Option<(f64, MsSsim)>,
}

impl<'a> PixelLoss<'a> {
    /// For pictures of `size` (height, width). Terms of weight 0 are not computed.
    pub(super) fn new(
        recipe: &LossRecipe,
        size: (usize, usize),
        lpips: Option<&'a Lpips>,
        device: &Device,
    ) -> Result<Self> {
        let lpips = lpips.filter(|_| recipe.lpips > 0.0);
        let ms_ssim = match recipe.ms_ssim > 0.0 {
            true => Some((recipe.ms_ssim, MsSsim::new(size)?.on(device)?)),
            false => None,
        };
        Ok(Self {
            weight: recipe.pixel,
            lpips: lpips.map(|lpips| (recipe.lpips, lpips)),
            ms_ssim,
        })
    }

    /// Loss of `found` against `truth`, both (N, H, W, 3) in 0..1; with perceptual terms if `is_perceptual`.
    pub(super) fn of(
        &self,
        found: &Tensor,
        truth: &Tensor,
        is_perceptual: bool,
    ) -> Result<(Tensor, Vec<(&'static str, f64)>)> {
        let mut parts = vec![("pixel_mse", 1.0, (found - truth)?.sqr()?.mean_all()?)];
        if is_perceptual {
            if let Some((weight, lpips)) = &self.lpips {
                parts.push(("lpips", *weight, lpips.distance(found, truth)?));
            }
            if let Some((weight, ms_ssim)) = &self.ms_ssim {
                let unlike = (1.0 - ms_ssim.of(found, truth)?)?;
                parts.push(("ms_ssim_loss", *weight, unlike));
            }
        }
        for (_, weight, _) in &mut parts {
            *weight *= self.weight;
        }
        weighted(&parts)
    }
}
