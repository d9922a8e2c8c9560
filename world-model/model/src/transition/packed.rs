//! The transition model for inference on the CPU: weights packed once, and a pass over new frames
//! that goes from barrier to barrier in blocks of tokens which stay in cache.
//!
//! Between two attentions within a frame everything is local to a token: normalisation, products,
//! the attention over time (the same place in other frames), the feed-forward network. So a pass
//! cuts every frame into blocks of tokens, and a task takes one block of all new frames from one
//! spatial attention to the next; a model of n blocks has n barriers. A task's activations stay in
//! its processor's cache, and all that it writes is its own, so there is nothing to lock.
//!
//! Temporal attention is causal, so what a frame contributes to later ones, its keys and values in
//! every block, does not depend on them: it is computed once ([`FrameContext`]) and used in every
//! integration step of every later frame, and shared by all candidates of a plan.

mod frame_context;
mod head;
mod kept;
mod modulation;
mod pass;
mod projection;
mod source;
mod tasks;

use std::sync::Arc;

use candle_core::{Device, Tensor};

use super::{Transition, TransitionConfig};
use crate::NumberFormat;
use crate::Result;
use crate::ops::block_attention::TokenBlocks;
use crate::ops::{PackedLinear, RotaryTable};
use crate::transition::network::Network;
pub(crate) use frame_context::FrameContext;
pub(crate) use modulation::Modulation;
pub use pass::NewFrame;
pub(crate) use pass::PassOutput;
pub use source::PackedSource;
use source::{NamedLayers, OfTransition, numbers};

/// The transition model, ready for inference. Clones share everything.
#[derive(Clone, Debug)]
pub struct PackedTransition {
    config: Arc<TransitionConfig>,
    layers: Arc<Layers>,
}

#[derive(Debug)]
struct Layers {
    /// What weights are packed in.
    format: NumberFormat,
    blocks: TokenBlocks,
    /// Angles of the tokens of a frame.
    grid: RotaryTable,
    /// Patches (p * p * C, values in the order row, column, channel) to tokens.
    embedding: PackedLinear,
    network: Network<PackedLinear>,
}

impl PackedTransition {
    /// Packs the weights of `model`, which is not needed afterwards.
    ///
    /// # Errors
    /// If its tensors cannot be read.
    pub fn new(model: &Transition, format: NumberFormat) -> Result<Self> {
        let config = model.config.as_ref().clone();
        Self::build(config, &OfTransition { model, format })
    }

    /// Builds the model of packed weights that `source` gives by the names of the parameters: without a copy of them as
    /// tensors, which is as large as the model.
    ///
    /// # Errors
    /// If the configuration cannot be built, `source` fails, or it gives weights of another shape.
    pub fn build(config: TransitionConfig, source: &dyn PackedSource) -> Result<Self> {
        config.validate()?;
        let mut named = NamedLayers {
            config: &config,
            source,
        };
        let (rows, columns) = config.grid();
        let layers = Layers {
            format: source.format(),
            blocks: TokenBlocks::new(rows * columns, config.heads, config.head_dim()),
            grid: config.rotary(),
            embedding: named.patches()?,
            network: Network::new(&config, &mut named)?,
        };
        Ok(Self {
            config: Arc::new(config),
            layers: Arc::new(layers),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &TransitionConfig {
        &self.config
    }

    /// What weights are packed in.
    pub fn format(&self) -> NumberFormat {
        self.layers.format
    }

    /// The velocity at every frame, as [`Transition::forward`] gives it.
    ///
    /// # Errors
    /// If the shapes do not fit the configuration.
    pub fn forward(&self, x: &Tensor, tau: &Tensor, action: &Tensor) -> Result<Tensor> {
        let (batch, times) = self.config.check_input(x, tau, action)?;
        let parts = (0..times)
            .map(|t| {
                let frame = |tensor: &Tensor| numbers(&tensor.narrow(1, t, 1)?);
                Ok((frame(x)?, frame(tau)?, frame(action)?))
            })
            .collect::<Result<Vec<_>>>()?;
        let frames: Vec<NewFrame<'_>> = parts
            .iter()
            .map(|(latents, tau, action)| NewFrame {
                latents,
                tau,
                action,
            })
            .collect();
        let c = &self.config;
        let shape = (batch, c.latent_height, c.latent_width, c.channels);
        let outputs = self
            .pass_of_any_length(&[], &frames, 0, 0)?
            .outputs
            .into_iter()
            .map(|output| Tensor::from_vec(output, shape, &Device::Cpu))
            .collect::<candle_core::Result<Vec<_>>>()?;
        let output = Tensor::stack(&outputs, 1)?;
        c.parametrisation.velocities(&output, x, tau)
    }
}
