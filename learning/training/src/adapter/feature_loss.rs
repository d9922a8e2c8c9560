//! Loss of the adapter: the error of features reconstructed from a latent, and the latent's divergence from a unit
//! Gaussian.

use anyhow::{Context as _, Result};
use candle_core::{D, Device, Tensor};

use super::LossRecipe;

/// Added under square roots, whose slope at 0 is infinite.
const TINY: f64 = 1e-12;

/// Squared error, cosine, spectrum and divergence.
pub(super) struct FeatureLoss {
    cosine: f64,
    spectrum: f64,
    /// Cosines beside sines: (tokens, 2 (tokens / 2 + 1)).
    waves: Tensor,
}

impl FeatureLoss {
    /// For features with `tokens` tokens.
    pub(super) fn new(recipe: &LossRecipe, tokens: usize, device: &Device) -> Result<Self> {
        Ok(Self {
            cosine: recipe.cosine,
            spectrum: recipe.spectrum,
            waves: waves(tokens)?.to_device(device)?,
        })
    }

    /// Loss of the features `found` against `truth`, both (N, h, w, D), through a latent with this mean and log
    /// variance; `divergence` is the weight of its divergence.
    pub(super) fn of(
        &self,
        truth: &Tensor,
        found: &Tensor,
        (mean, log_variance): (&Tensor, &Tensor),
        divergence: f64,
    ) -> Result<(Tensor, Vec<(&'static str, f64)>)> {
        let squared = (found - truth)?.sqr()?.mean_all()?;
        let cosine = (1.0 - cosines(truth, found)?.mean_all()?)?;
        let spectrum = (self.magnitudes(truth)? - self.magnitudes(found)?)?;
        let spectrum = spectrum.abs()?.mean_all()?;
        let kl = (mean.sqr()? + log_variance.exp()?)? - (log_variance + 1.0)?;
        let kl = (kl?.mean_all()? * 0.5)?;
        let parts = [
            ("feature_mse", 1.0, squared),
            ("feature_cosine", self.cosine, cosine),
            ("feature_spectrum", self.spectrum, spectrum),
            ("kl", divergence, kl),
        ];
        weighted(&parts)
    }

    /// (N, h, w, D) to (N D, frequencies): the magnitudes of each channel's spectrum along the tokens, unnormalised as
    /// in `torch.fft.rfft`.
    fn magnitudes(&self, features: &Tensor) -> Result<Tensor> {
        let (n, h, w, channels) = features.dims4()?;
        let series = features.reshape((n, h * w, channels))?.transpose(1, 2)?;
        let series = series.contiguous()?.reshape((n * channels, h * w))?;
        let both = series.matmul(&self.waves)?;
        let frequencies = h * w / 2 + 1;
        let part = |start| both.narrow(1, start, frequencies)?.sqr();
        Ok(((part(0)? + part(frequencies)?)? + TINY)?.sqrt()?)
    }
}

/// The weighted sum of parts, and the parts by name.
pub(super) fn weighted(
    parts: &[(&'static str, f64, Tensor)],
) -> Result<(Tensor, Vec<(&'static str, f64)>)> {
    let mut total: Option<Tensor> = None;
    let mut values = Vec::with_capacity(parts.len());
    for (name, weight, part) in parts {
        let part_of_total = (part * *weight)?;
        total = Some(match total {
            None => part_of_total,
            Some(total) => (total + part_of_total)?,
        });
        values.push((*name, f64::from(part.to_scalar::<f32>()?)));
    }
    Ok((total.context("a loss without parts")?, values))
}

/// Cosine between vectors along the last dimension.
pub(super) fn cosines(a: &Tensor, b: &Tensor) -> Result<Tensor> {
    let length = |x: &Tensor| (x.sqr()?.sum(D::Minus1)? + TINY)?.sqrt();
    Ok(((a * b)?.sum(D::Minus1)? / (length(a)? * length(b)?)?)?)
}

fn waves(tokens: usize) -> Result<Tensor> {
    let frequencies = tokens / 2 + 1;
    let mut values = Vec::with_capacity(tokens * 2 * frequencies);
    for token in 0..tokens {
        let angle = |frequency: usize| {
            let turns = (token * frequency % tokens) as f64 / tokens as f64;
            turns * std::f64::consts::TAU
        };
        values.extend((0..frequencies).map(|frequency| angle(frequency).cos() as f32));
        values.extend((0..frequencies).map(|frequency| angle(frequency).sin() as f32));
    }
    Ok(Tensor::from_vec(
        values,
        (tokens, 2 * frequencies),
        &Device::Cpu,
    )?)
}
