//! Training of the autoencoder: L1 and squared error of the picture, latents pulled towards a unit Gaussian and
//! disturbed by a little noise, on crops most of which show what moves.

mod arguments;
mod crops;
mod evaluation;
mod salience;
mod trainer;

pub use arguments::{EvaluateAutoencoderArgs, TrainAutoencoderArgs};
pub use evaluation::{Reconstruction, evaluate, picture};
pub use trainer::TrainingError;

use serde::{Deserialize, Serialize};
use wm_model::{AutoencoderConfig, Fit};

use crate::recipe::{Bundled, Optimisation, Span, is_recipe};

/// The recipes that are part of the program. The paper trains no autoencoder.
pub const RECIPES: Bundled = &[("tiny", include_str!("../recipes/tiny/autoencoder.yaml"))];

/// Every number of a training of the autoencoder; `recipes/tiny/autoencoder.yaml` says what each is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AutoencoderRecipe {
    /// Seed of the weights and of every draw.
    pub seed: u64,
    /// How long to train; an epoch is one crop of each episode.
    pub length: Span,
    /// Steps between validations.
    pub validate_every: u64,
    /// Wall-clock time between checkpoints \[s\].
    pub checkpoint_seconds: u64,
    /// Crops a step.
    pub batch: usize,
    /// Pixels in each direction of a crop.
    pub crop: usize,
    /// Share of the steps, at the end, that see whole pictures, so that the borders and the far context are learnt as they
    /// will be.
    pub whole_picture_share: f64,
    /// Share of the crops that are centred on something salient.
    pub salient: f64,
    /// Weight of the pixels inside masks, added to 1.
    pub mask_weight: f32,
    /// Weight of the squared error beside the absolute one.
    pub squared: f32,
    /// Weight of the mean square of the latents.
    pub latent_penalty: f32,
    /// Standard deviation of the noise added to the latents.
    pub latent_noise: f32,
    /// How pictures of another aspect become pictures of the model's size.
    pub fit: Fit,
    /// Shape of the networks.
    pub model: AutoencoderConfig,
    /// The optimiser.
    pub optimisation: Optimisation,
}

is_recipe!(AutoencoderRecipe);

impl AutoencoderRecipe {
    /// How many of `steps` see whole pictures.
    fn whole_picture_steps(&self, steps: u64) -> u64 {
        (self.whole_picture_share * steps as f64).round() as u64
    }
}

#[cfg(test)]
pub(crate) mod tests;
