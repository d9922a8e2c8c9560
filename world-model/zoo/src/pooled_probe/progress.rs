//! The progress of a task, frame by frame.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::{default_max_frames, default_pool, pooled};
use crate::layers::{Activation, Linear};
use crate::sizes::check_sizes;
use crate::{Loader, Result};

/// Sizes of the progress probe. JSON: `{"features": 1024, "pool": 1, "hidden": 256}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgressProbeConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Rows, and columns, that a frame is pooled to; 1 is its mean.
    #[serde(default = "default_pool")]
    pub pool: usize,
    /// Width of the hidden layer.
    #[serde(default = "default_hidden")]
    pub hidden: usize,
    /// Frames of the longest episode that it is given.
    #[serde(default = "default_max_frames")]
    pub max_frames: usize,
}

fn default_hidden() -> usize {
    256
}

/// Linear, exact GELU, linear, sigmoid, on each pooled frame. Names: `head.{0,2}.*`.
#[derive(Clone, Debug)]
pub struct ProgressProbe {
    config: ProgressProbeConfig,
    head: [Linear; 2],
    dtype: DType,
}

impl ProgressProbe {
    /// Loads the probe.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &ProgressProbeConfig, loader: &Loader<'_>) -> Result<Self> {
        let c = config;
        check_sizes(&[
            ("features", c.features),
            ("pool", c.pool),
            ("hidden", c.hidden),
            ("max_frames", c.max_frames),
        ])?;
        Ok(Self {
            config: c.clone(),
            head: [
                loader.linear("head.0", c.pool * c.pool * c.features, c.hidden)?,
                loader.sensitive().linear("head.2", c.hidden, 1)?,
            ],
            dtype: loader.dtype(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &ProgressProbeConfig {
        &self.config
    }

    /// The progress of each frame (B, T), f32, 0 at the start and 1 where the task is done, of `latents` (B, T, h, w,
    /// features).
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward(&self, latents: &Tensor) -> Result<Tensor> {
        let c = &self.config;
        let frames = pooled(latents, c.features, c.pool, c.max_frames)?;
        let [first, second] = &self.head;
        let frames = frames.to_dtype(self.dtype)?;
        let hidden = first.forward_activated(&frames, Activation::GeluExact)?;
        let logit = second.forward(&hidden)?.to_dtype(DType::F32)?.squeeze(2)?;
        // 1 / (1 + exp(-x)), by tanh, which does not overflow.
        Ok((((logit * 0.5)?.tanh()? + 1.0)? * 0.5)?)
    }
}
