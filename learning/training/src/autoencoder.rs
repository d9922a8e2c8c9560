//! Training of the autoencoder: absolute and squared error of the picture, with latents pulled towards a unit Gaussian
//! and slightly noised, on crops that mostly show moving things.

mod arguments;
mod crops;
mod error;
mod evaluation;
mod salience;
mod trainer;

pub use arguments::{EvaluateAutoencoderArgs, TrainAutoencoderArgs};
pub use error::TrainingError;
pub use evaluation::{Reconstruction, evaluate, picture};

use serde::{Deserialize, Serialize};
use wm_model::{AutoencoderConfig, Fit};

use crate::recipe::{Bundled, Course, Optimisation, Recipe, Span};

/// Settings of autoencoder training, explained in `recipes/tiny/autoencoder.yaml`. The paper trains no autoencoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AutoencoderRecipe {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Length of the training; an epoch is one crop of each episode.
    pub length: Span,
    /// Steps between validations.
    pub validate_every: u64,
    /// Wall-clock time between checkpoints \[s\].
    pub checkpoint_seconds: u64,
    /// Crops per step.
    pub batch: usize,
    /// Side of a crop \[px\].
    pub crop: usize,
    /// Share of the steps, at the end, on whole pictures, which train borders and distant context.
    pub whole_picture_share: f64,
    /// Share of the crops centred on a salient pixel.
    pub salient: f64,
    /// Additional weight of pixels inside masks.
    pub mask_weight: f32,
    /// Weight of the squared error relative to the absolute error.
    pub squared: f32,
    /// Weight of the mean square of the latents.
    pub latent_penalty: f32,
    /// Standard deviation of the noise added to the latents.
    pub latent_noise: f32,
    /// How pictures of another aspect fit the model's size.
    pub fit: Fit,
    /// Shape of the networks.
    pub model: AutoencoderConfig,
    /// The optimiser.
    pub optimisation: Optimisation,
}

impl Recipe for AutoencoderRecipe {
    const BUNDLED: Bundled = &[("tiny", include_str!("../recipes/tiny/autoencoder.yaml"))];

    fn course(&self) -> Course<'_> {
        Course {
            seed: self.seed,
            length: self.length,
            batch: self.batch,
            micro_batch: self.batch,
            validate_every: self.validate_every,
            checkpoint_seconds: self.checkpoint_seconds,
            optimisation: &self.optimisation,
        }
    }
}

impl AutoencoderRecipe {
    /// Number of `steps` on whole pictures.
    fn whole_picture_steps(&self, steps: u64) -> u64 {
        (self.whole_picture_share * steps as f64).round() as u64
    }
}

#[cfg(test)]
pub(crate) mod tests;
