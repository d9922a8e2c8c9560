//! A linear layer on each frame.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::{default_max_frames, default_pool, pooled};
use crate::layers::Linear;
use crate::sizes::check_sizes;
use crate::{Loader, Result};

/// Sizes of the linear probe. JSON: `{"features": 1024, "pool": 4}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearProbeConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Rows, and columns, that a frame is pooled to: 1 (its mean, the default), 4 or 8 in the release.
    #[serde(default = "default_pool")]
    pub pool: usize,
    /// Frames of the longest episode that it is given.
    #[serde(default = "default_max_frames")]
    pub max_frames: usize,
}

/// Logistic regression on pooled frames. Names: `head.{weight,bias}`, (1, pool * pool * features) and (1).
#[derive(Clone, Debug)]
pub struct LinearProbe {
    config: LinearProbeConfig,
    head: Linear,
    dtype: DType,
}

impl LinearProbe {
    /// Loads the probe.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &LinearProbeConfig, loader: &Loader<'_>) -> Result<Self> {
        check_sizes(&[
            ("features", config.features),
            ("pool", config.pool),
            ("max_frames", config.max_frames),
        ])?;
        let values = config.pool * config.pool * config.features;
        Ok(Self {
            config: config.clone(),
            head: loader.sensitive().linear("head", values, 1)?,
            dtype: loader.dtype(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &LinearProbeConfig {
        &self.config
    }

    /// The logit of success (B), f32, of `latents` (B, T, h, w, features): the mean of the frames'.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward(&self, latents: &Tensor) -> Result<Tensor> {
        let c = &self.config;
        // The mean of linear functions is that of their inputs.
        let mean = pooled(latents, c.features, c.pool, c.max_frames)?.mean(1)?;
        let logit = self.head.forward(&mean.to_dtype(self.dtype)?)?;
        Ok(logit.to_dtype(DType::F32)?.squeeze(1)?)
    }
}
