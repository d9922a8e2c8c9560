//! Training of the autoencoder: L1 and squared error of the picture, latents pulled towards a unit Gaussian and
//! disturbed by a little noise, on crops most of which show what moves.

mod arguments;
mod crops;
mod evaluation;
mod salience;
mod trainer;

pub use arguments::{EvaluateAutoencoderArgs, TrainAutoencoderArgs};
pub use evaluation::{Reconstruction, evaluate, picture};
pub use trainer::{TrainingError, train};

use serde::{Deserialize, Serialize};
use wm_model::AutoencoderConfig;

/// All that decides what a training gives, together with the data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AutoencoderSettings {
    /// Shape of the networks.
    pub model: AutoencoderConfig,
    /// Seed of the weights and of every draw.
    pub seed: u64,
    /// Steps in all.
    pub steps: u64,
    /// Steps at the end that see whole pictures, so that the borders and the far context are learnt as they will be.
    pub whole_picture_steps: u64,
    /// Crops a step.
    pub batch: usize,
    /// Pixels in each direction of a crop.
    pub crop: usize,
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
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Steps until it is reached.
    pub warm_up_steps: u64,
    /// Last learning rate as a fraction of the highest.
    pub final_rate: f64,
    /// Decay of the moving average of the weights, which is what is saved.
    pub ema_decay: f64,
}

impl Default for AutoencoderSettings {
    fn default() -> Self {
        Self {
            model: AutoencoderConfig::tiny(),
            seed: 0,
            steps: 5500,
            whole_picture_steps: 900,
            batch: 16,
            crop: 64,
            salient: 0.85,
            mask_weight: 3.0,
            squared: 2.0,
            latent_penalty: 3e-4,
            latent_noise: 0.05,
            learning_rate: 1.5e-3,
            warm_up_steps: 100,
            final_rate: 0.02,
            ema_decay: 0.998,
        }
    }
}

#[cfg(test)]
mod tests;
