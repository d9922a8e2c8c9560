use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use super::{ConvolutionalIdm, ConvolutionalIdmConfig, Idm, IdmConfig};
use crate::layers::Dropout;
use crate::{Loader, Result};

/// Kind and sizes of an inverse dynamics model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum IdmNetworkConfig {
    /// The paper's.
    Transformer(IdmConfig),
    /// The small one.
    Convolutional(ConvolutionalIdmConfig),
}

impl IdmNetworkConfig {
    /// Number k of actions between k + 1 latents.
    pub fn horizon(&self) -> usize {
        match self {
            Self::Transformer(config) => config.horizon,
            Self::Convolutional(config) => config.horizon,
        }
    }
}

/// An inverse dynamics model of either kind.
#[derive(Clone, Debug)]
pub enum IdmNetwork {
    /// The paper's.
    Transformer(Idm),
    /// The small one.
    Convolutional(ConvolutionalIdm),
}

impl IdmNetwork {
    /// Loads the model.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &IdmNetworkConfig, loader: &Loader<'_>) -> Result<Self> {
        Ok(match config {
            IdmNetworkConfig::Transformer(config) => Self::Transformer(Idm::load(config, loader)?),
            IdmNetworkConfig::Convolutional(config) => {
                Self::Convolutional(ConvolutionalIdm::load(config, loader)?)
            }
        })
    }

    /// Number k of actions between k + 1 latents.
    pub fn horizon(&self) -> usize {
        match self {
            Self::Transformer(model) => model.config().horizon,
            Self::Convolutional(model) => model.config().horizon,
        }
    }

    /// Latents (B, k + 1, h, w, C) to the actions between them (B, k, actions), f32, in the normalised units that the model
    /// was trained on.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward(&self, latents: &Tensor) -> Result<Tensor> {
        self.forward_dropping(latents, &mut Dropout::none())
    }

    /// Latents (B, k + 1, h, w, C) to what the last layers read of each action (B, k, width), f32: the features of the paper's
    /// action trajectories.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn features(&self, latents: &Tensor) -> Result<Tensor> {
        match self {
            Self::Transformer(model) => model.features(latents),
            Self::Convolutional(model) => model.features(latents),
        }
    }

    /// The same as [`Self::forward`] in training, with dropout.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward_dropping(&self, latents: &Tensor, dropout: &mut Dropout<'_>) -> Result<Tensor> {
        match self {
            Self::Transformer(model) => model.forward_dropping(latents, dropout),
            Self::Convolutional(model) => model.forward_dropping(latents, dropout),
        }
    }
}
