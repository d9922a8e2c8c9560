use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use super::{GroundedProbe, GroundedProbeConfig, Reading, SuccessProbe, SuccessProbeConfig};
use crate::layers::Dropout;
use crate::{Loader, Result};

/// Kind and sizes of a success probe that reads instructions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ProbeNetworkConfig {
    /// The paper's.
    Transformer(SuccessProbeConfig),
    /// The small one, which looks for what an instruction names.
    Grounded(GroundedProbeConfig),
}

impl ProbeNetworkConfig {
    /// Frames of the longest episode.
    pub fn max_frames(&self) -> usize {
        match self {
            Self::Transformer(config) => config.max_frames,
            Self::Grounded(config) => config.max_frames,
        }
    }

    /// Channels of the latents.
    pub fn features(&self) -> usize {
        match self {
            Self::Transformer(config) => config.features,
            Self::Grounded(config) => config.features,
        }
    }

    /// Channels of the text's tokens.
    pub fn text_features_mut(&mut self) -> &mut usize {
        match self {
            Self::Transformer(config) => &mut config.text_features,
            Self::Grounded(config) => &mut config.text_features,
        }
    }
}

/// A success probe of either kind.
#[derive(Clone, Debug)]
pub enum ProbeNetwork {
    /// The paper's.
    Transformer(Box<SuccessProbe>),
    /// The small one, which looks for what an instruction names.
    Grounded(Box<GroundedProbe>),
}

impl ProbeNetwork {
    /// Loads the probe.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &ProbeNetworkConfig, loader: &Loader<'_>) -> Result<Self> {
        Ok(match config {
            ProbeNetworkConfig::Transformer(config) => {
                Self::Transformer(Box::new(SuccessProbe::load(config, loader)?))
            }
            ProbeNetworkConfig::Grounded(config) => {
                Self::Grounded(Box::new(GroundedProbe::load(config, loader)?))
            }
        })
    }

    /// Frames of the longest episode.
    pub fn max_frames(&self) -> usize {
        match self {
            Self::Transformer(probe) => probe.config().max_frames,
            Self::Grounded(probe) => probe.config().max_frames,
        }
    }

    /// The logit of success (1), f32, of an episode of `latents` (1, T, h, w, C) under an instruction.
    ///
    /// # Errors
    /// If the shapes do not fit.
    pub fn forward(&self, latents: &Tensor, instruction: &Reading) -> Result<Tensor> {
        let Reading { features, mask } = instruction;
        match self {
            Self::Transformer(probe) => probe.forward(latents, features, mask.as_ref()),
            Self::Grounded(probe) => {
                let asked = probe.read(features, mask.as_ref())?;
                let seen = probe.look(latents)?;
                Ok(probe.answer(&seen, &[asked], &mut Dropout::none())?.logits)
            }
        }
    }
}
