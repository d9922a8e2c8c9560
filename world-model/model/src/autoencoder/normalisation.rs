//! Normalisation of latents, channel by channel.

use sha2::{Digest, Sha256};

use crate::weights::{Precision, WeightsBuilder};
use crate::{Error, Result, Weights};

/// Tensor of the means in a weights file.
pub const MEAN: &str = "latent_mean";
/// Tensor of the standard deviations in a weights file.
pub const STD: &str = "latent_std";

/// Mean and standard deviation of each channel over the training data.
#[derive(Clone, Debug, PartialEq)]
pub struct Normalisation {
    /// Mean of each channel.
    pub mean: Vec<f32>,
    /// Standard deviation of each channel.
    pub std: Vec<f32>,
}

impl Normalisation {
    /// Leaves latents as they are.
    pub fn identity(channels: usize) -> Self {
        Self {
            mean: vec![0.0; channels],
            std: vec![1.0; channels],
        }
    }

    /// Mean and standard deviation of `latents` (any shape, channels last).
    ///
    /// # Errors
    /// If there are no latents or a channel does not vary.
    pub fn of(latents: impl IntoIterator<Item = Vec<f32>>, channels: usize) -> Result<Self> {
        let mut sums = vec![(0f64, 0f64); channels];
        let mut count = 0usize;
        for latent in latents {
            for place in latent.chunks_exact(channels.max(1)) {
                count += 1;
                for (v, (sum, squares)) in place.iter().zip(&mut sums) {
                    *sum += f64::from(*v);
                    *squares += f64::from(*v) * f64::from(*v);
                }
            }
        }
        let count = count.max(1) as f64;
        let normalisation = Self {
            mean: sums.iter().map(|(sum, _)| (sum / count) as f32).collect(),
            std: sums
                .iter()
                .map(|(sum, squares)| {
                    let mean = sum / count;
                    (squares / count - mean * mean).max(0.0).sqrt() as f32
                })
                .collect(),
        };
        normalisation.check(channels)?;
        Ok(normalisation)
    }

    /// Checks that there are one mean and one positive standard deviation for each of `channels`.
    ///
    /// # Errors
    /// [`Error::Config`] says what is wrong.
    pub fn check(&self, channels: usize) -> Result<()> {
        if self.mean.len() != channels || self.std.len() != channels {
            return Err(Error::config(
                "normalisation",
                format!(
                    "{} means and {} standard deviations, expected {channels} of each",
                    self.mean.len(),
                    self.std.len()
                ),
            ));
        }
        if let Some(c) = self.mean.iter().position(|v| !v.is_finite()) {
            let reason = format!("channel {c} is not finite: {:?}", self.mean.get(c));
            return Err(Error::config(MEAN, reason));
        }
        match self.std.iter().position(|v| !v.is_normal() || *v < 0.0) {
            None => Ok(()),
            Some(c) => Err(Error::config(
                STD,
                format!("channel {c} is not positive: {:?}", self.std.get(c)),
            )),
        }
    }

    pub(super) fn load(weights: &Weights, channels: usize) -> Result<Self> {
        let normalisation = Self {
            mean: weights.values(MEAN, &[channels])?,
            std: weights.values(STD, &[channels])?,
        };
        normalisation.check(channels)?;
        Ok(normalisation)
    }

    pub(super) fn store(&self, builder: &mut WeightsBuilder) {
        builder.values(MEAN, &[self.mean.len()], &self.mean, Precision::F32);
        builder.values(STD, &[self.std.len()], &self.std, Precision::F32);
    }

    /// Adds means and standard deviations to a hash.
    pub fn add_to(&self, hash: &mut Sha256) {
        for v in self.mean.iter().chain(&self.std) {
            hash.update(v.to_le_bytes());
        }
    }

    /// Normalises `latents` (channels last) in place.
    pub fn apply(&self, latents: &mut [f32]) {
        for place in latents.chunks_exact_mut(self.mean.len().max(1)) {
            for ((v, mean), std) in place.iter_mut().zip(&self.mean).zip(&self.std) {
                *v = (*v - mean) / std;
            }
        }
    }

    /// The inverse of [`Normalisation::apply`].
    pub fn undo(&self, latents: &mut [f32]) {
        for place in latents.chunks_exact_mut(self.mean.len().max(1)) {
            for ((v, mean), std) in place.iter_mut().zip(&self.mean).zip(&self.std) {
                *v = *v * std + mean;
            }
        }
    }
}
