use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use super::{GroundedProbe, GroundedProbeConfig, Reading, SuccessProbe, SuccessProbeConfig};
use crate::layers::Dropout;
use crate::pooled_probe::{LinearProbe, LinearProbeConfig, TemporalProbe, TemporalProbeConfig};
use crate::{Loader, Result};

/// Kind and sizes of a success probe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ProbeNetworkConfig {
    /// The paper's.
    Transformer(SuccessProbeConfig),
    /// The small one, which looks for what an instruction names.
    Grounded(GroundedProbeConfig),
    /// A linear layer on pooled latents, which reads no instruction.
    Linear(LinearProbeConfig),
    /// A transformer block over pooled frames, which reads no instruction.
    Temporal(TemporalProbeConfig),
}

impl ProbeNetworkConfig {
    /// Frames of the longest episode.
    pub fn max_frames(&self) -> usize {
        match self {
            Self::Transformer(config) => config.max_frames,
            Self::Grounded(config) => config.max_frames,
            Self::Linear(config) => config.max_frames,
            Self::Temporal(config) => config.max_frames,
        }
    }

    /// Channels of the latents.
    pub fn features(&self) -> usize {
        match self {
            Self::Transformer(config) => config.features,
            Self::Grounded(config) => config.features,
            Self::Linear(config) => config.features,
            Self::Temporal(config) => config.features,
        }
    }

    /// Channels of the text's tokens; `None` for a probe that reads no instruction.
    pub fn text_features_mut(&mut self) -> Option<&mut usize> {
        match self {
            Self::Transformer(config) => Some(&mut config.text_features),
            Self::Grounded(config) => Some(&mut config.text_features),
            Self::Linear(_) | Self::Temporal(_) => None,
        }
    }
}

/// A success probe of any kind.
#[derive(Clone, Debug)]
pub enum ProbeNetwork {
    /// The paper's.
    Transformer(Box<SuccessProbe>),
    /// The small one, which looks for what an instruction names.
    Grounded(Box<GroundedProbe>),
    /// A linear layer on pooled latents, which reads no instruction.
    Linear(LinearProbe),
    /// A transformer block over pooled frames, which reads no instruction.
    Temporal(Box<TemporalProbe>),
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
            ProbeNetworkConfig::Linear(config) => Self::Linear(LinearProbe::load(config, loader)?),
            ProbeNetworkConfig::Temporal(config) => {
                Self::Temporal(Box::new(TemporalProbe::load(config, loader)?))
            }
        })
    }

    /// What kind it is, as its configuration says.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Transformer(_) => "transformer",
            Self::Grounded(_) => "grounded",
            Self::Linear(_) => "linear",
            Self::Temporal(_) => "temporal",
        }
    }

    /// Whether its answer depends on an instruction.
    pub fn reads_instructions(&self) -> bool {
        matches!(self, Self::Transformer(_) | Self::Grounded(_))
    }

    /// Frames of the longest episode.
    pub fn max_frames(&self) -> usize {
        match self {
            Self::Transformer(probe) => probe.config().max_frames,
            Self::Grounded(probe) => probe.config().max_frames,
            Self::Linear(probe) => probe.config().max_frames,
            Self::Temporal(probe) => probe.config().max_frames,
        }
    }

    /// The logit of success (1), f32, of an episode of `latents` (1, T, h, w, C) under an instruction, which only a probe
    /// that [reads it](Self::reads_instructions) needs.
    ///
    /// # Errors
    /// If the shapes do not fit, or the instruction was not read.
    pub fn forward(&self, latents: &Tensor, instruction: Option<&Reading>) -> Result<Tensor> {
        let read = || {
            instruction.ok_or_else(|| {
                let reason = "not read, which this probe needs";
                wm_model::Error::config("instruction", reason.to_owned())
            })
        };
        match self {
            Self::Transformer(probe) => {
                let Reading { features, mask } = read()?;
                probe.forward(latents, features, mask.as_ref())
            }
            Self::Grounded(probe) => {
                let Reading { features, mask } = read()?;
                let asked = probe.read(features, mask.as_ref())?;
                let seen = probe.look(latents)?;
                Ok(probe.answer(&seen, &[asked], &mut Dropout::none())?.logits)
            }
            Self::Linear(probe) => probe.forward(latents),
            Self::Temporal(probe) => probe.forward(latents),
        }
    }
}
