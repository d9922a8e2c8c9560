use std::path::Path;

use candle_core::Tensor;
use wm_model::Kernels;
use wm_model::{
    LatentSpace, Weights,
    transition::{ACTIONS_KEY, LATENT_SPACE_KEY},
};
use wm_motion::actions::ActionEncoding;

use super::{IdmNetwork, IdmNetworkConfig};
use crate::{Loader, Result, loader::OfWeights};

/// Metadata key of the [`IdmNetworkConfig`] (JSON).
pub const IDM_KEY: &str = "idm";

/// An inverse dynamics model that the training wrote, with what its inputs and outputs are.
#[derive(Clone, Debug)]
pub struct TrainedIdm {
    idm: IdmNetwork,
    space: LatentSpace,
    encoding: ActionEncoding,
}

impl TrainedIdm {
    /// Opens a file that `wm train idm` wrote.
    ///
    /// # Errors
    /// If the file cannot be read, or a tensor or an entry of its metadata is missing, misshapen or unexpected.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_weights(Weights::open(path)?)
    }

    /// The same from weights that are already read.
    ///
    /// # Errors
    /// If a tensor or an entry of the metadata is missing, misshapen or unexpected.
    pub fn from_weights(weights: Weights) -> Result<Self> {
        let config: IdmNetworkConfig = weights.json(IDM_KEY)?;
        let idm = IdmNetwork::load(
            &config,
            &Loader::supplied(&OfWeights(&weights), Kernels::Cpu),
        )?;
        let (space, encoding) = (weights.json(LATENT_SPACE_KEY)?, weights.json(ACTIONS_KEY)?);
        weights.finish()?;
        Ok(Self {
            idm,
            space,
            encoding,
        })
    }

    /// The network.
    pub fn idm(&self) -> &IdmNetwork {
        &self.idm
    }

    /// The space of the latents that it reads.
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// What its actions are.
    pub fn encoding(&self) -> &ActionEncoding {
        &self.encoding
    }

    /// Consecutive latents (B, k + 1, h, w, C), one model step apart, to the model's actions between them
    /// (B, k, actions).
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn actions(&self, latents: &Tensor) -> Result<Tensor> {
        self.idm.forward(latents)
    }
}
