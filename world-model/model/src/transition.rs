//! The transition model: a diffusion transformer over the patches of the last latents.
//!
//! Given a window of latents, of which each frame has its own noise level tau, and the actions
//! between them, it gives the velocity of flow matching, (noise - clean), at every frame. Blocks
//! alternate attention within a frame with causal attention over time; noise level and action
//! modulate every layer. Names of parameters are those of the published checkpoints.
//!
//! ```
//! use candle_core::{Device, Tensor};
//! use wm_model::transition::{Transition, TransitionConfig};
//!
//! # fn main() -> wm_model::Result<()> {
//! let config = TransitionConfig::preset("tiny", (16, 16, 8), 2, 7)?;
//! let model = Transition::random(config, 1)?;
//! let latents = Tensor::zeros((1, 3, 16, 16, 8), candle_core::DType::F32, &Device::Cpu)?;
//! let tau = Tensor::new(&[[0.0f32, 0.0, 1.0]], &Device::Cpu)?;
//! let actions = Tensor::zeros((1, 3, 7), candle_core::DType::F32, &Device::Cpu)?;
//! let velocity = model.forward(&latents, &tau, &actions)?;
//! assert_eq!(velocity.dims(), [1, 3, 16, 16, 8]);
//! # Ok(())
//! # }
//! ```
//!
//! [`Transition`] is made of tensors, for training (`wm_training`, through [`Transition::build`] and
//! [`Transition::output`]) and as the reference ([`Transition::plain`]); [`LoadedTransition`] is the same model for
//! inference, on kernels of the CPU ([`PackedTransition`]) or where its tensors are ([`TensorTransition`]).
//! Sampling is not done here ([`crate::sampler`] does it).

mod block;
mod condition;
mod config;
mod embedding;
mod head;
mod linear_layer;
mod loaded;
mod network;
mod packed;
mod parameters;
mod parametrisation;
mod pattern;
mod taped_blocks;
mod tensors;
mod values;

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{DType, Device, Tensor};

pub use config::{ActionAlignment, TransitionConfig, published_shift};
pub use linear_layer::Initialisation;
pub(crate) use loaded::Modulation;
pub use loaded::{FrameContext, LoadedTransition, PassOutput};
pub use packed::{NewFrame, PackedSource, PackedTransition};
pub use parameters::Parameter;
pub use parametrisation::Parametrisation;
pub use pattern::TemporalPattern;
pub use tensors::TensorTransition;
pub(crate) use values::Batched;

pub use crate::ops::token_layers::WeightGradients;
use crate::ops::token_layers::{Linear, TensorLayers};
use crate::ops::{AttentionPattern, Axis};
use crate::{Compute, Error, Kernels, NumberFormat, Result, Weights};
use block::run_clips;
use condition::Condition;
use embedding::{Embedding, Patches};
use network::Network;
use taped_blocks::taped_blocks;

/// Metadata entry of a weights file that holds the [`TransitionConfig`] as JSON.
pub const CONFIG_KEY: &str = "config";
/// Metadata entry with the [`LatentSpace`](crate::LatentSpace) that it was trained on, as JSON.
pub const LATENT_SPACE_KEY: &str = "latent_space";
/// Metadata entry with the [`ActionEncoding`](wm_motion::actions::ActionEncoding), as JSON.
pub const ACTIONS_KEY: &str = "actions";

/// The transition model. Clones share their tensors.
#[derive(Clone, Debug)]
pub struct Transition {
    config: Arc<TransitionConfig>,
    embedding: Embedding,
    network: Network<Linear>,
    spatial: Arc<AttentionPattern>,
    kernels: Kernels,
    /// All tensors by their names, to be packed; layers share them.
    parameters: Arc<BTreeMap<String, Tensor>>,
    /// Where the gradients by the blocks' weights go, if not to candle.
    gradients: Option<WeightGradients>,
}

impl Transition {
    /// Builds the model from tensors that `source` supplies by name and shape. It computes on the device that they are
    /// on. Kernels on the CPU take f32; plain tensor operations takes parameters of 16 bits too, and multiplies in their format:
    /// everything but products is f32.
    ///
    /// # Errors
    /// If the configuration cannot be built, `source` fails, or it supplies tensors of several devices or formats.
    pub fn build(
        config: TransitionConfig,
        source: &mut dyn FnMut(&Parameter) -> Result<Tensor>,
    ) -> Result<Self> {
        config.validate()?;
        let mut tensors = parameters::Tensors::collect(&config, source)?;
        let parameters = Arc::new(tensors.rest().clone());
        let spatial =
            AttentionPattern::new(Axis::Space, config.heads, config.rotary(), |_, _| true)?;
        let embedding = Embedding::new(&mut tensors)?;
        let network = Network::new(&config, &mut tensors)?;
        Ok(Self {
            config: Arc::new(config),
            embedding,
            network,
            spatial: Arc::new(spatial),
            kernels: Kernels::default(),
            parameters,
            gradients: None,
        })
    }

    /// The same model for a training step on the CPU, where it is faster: gradients by the weights of its blocks go to
    /// `gradients` and not to candle's [`GradStore`](candle_core::backprop::GradStore); [`WeightGradients::take`] gives the
    /// sum of both. On other devices, and [`Self::plain`], nothing changes.
    #[must_use]
    pub fn collecting(&self, gradients: &WeightGradients) -> Self {
        Self {
            gradients: Some(gradients.clone()),
            ..self.clone()
        }
    }

    /// The same model on stock operations instead of kernels, as it is on every device but the CPU anyway.
    #[must_use]
    pub fn plain(self) -> Self {
        Self {
            kernels: Kernels::Candle,
            ..self
        }
    }

    /// Where it computes; inputs have to be there.
    pub fn device(&self) -> &Device {
        self.embedding.device()
    }

    /// Reads a model whose configuration is in the file's metadata.
    ///
    /// # Errors
    /// If the configuration or a tensor is missing or malformed, or there are tensors too many.
    pub fn from_weights(weights: Weights) -> Result<Self> {
        Self::from_weights_on(weights, &Compute::default())
    }

    /// As [`Self::from_weights`], with its tensors on the device of `compute`, in f32.
    ///
    /// # Errors
    /// As [`Self::from_weights`]; and if the device has no memory for them.
    pub(crate) fn from_weights_on(weights: Weights, compute: &Compute) -> Result<Self> {
        let config: TransitionConfig = weights.json(CONFIG_KEY)?;
        let model = Self::build(config, &mut |p| {
            compute.tensor(&weights.tensor(&p.name, &p.shape)?, DType::F32)
        })?;
        weights.finish()?;
        Ok(model)
    }

    /// A model with seeded random weights everywhere, those included that training starts at zero,
    /// so that every part of it has an effect. For tests and timing.
    ///
    /// # Errors
    /// If the configuration cannot be built.
    pub fn random(config: TransitionConfig, seed: u64) -> Result<Self> {
        Self::build(config, &mut |p| p.sample(seed))
    }

    /// The configuration.
    pub fn config(&self) -> &TransitionConfig {
        &self.config
    }

    /// The velocity at every frame: `x` (B, T, H, W, C) latents, `tau` (B, T) their noise levels,
    /// `action` (B, T, A) what is fed with each frame; gives (B, T, H, W, C).
    ///
    /// Frames attend to themselves and to earlier ones. Under [`ActionAlignment::WithFrame`]
    /// action t is the one that leads from frame t to the next, under
    /// [`ActionAlignment::WithResult`] the one that led to frame t. Under
    /// [`Parametrisation::Residual`] the frame before must be clean; the first one has none, and is
    /// its own.
    ///
    /// # Errors
    /// If the shapes do not fit the configuration, or an input is on another device.
    pub fn forward(&self, x: &Tensor, tau: &Tensor, action: &Tensor) -> Result<Tensor> {
        let (_, frames) = tau.dims2()?;
        let output = self.output(x, tau, action, &TemporalPattern::causal(frames), frames)?;
        self.config.parametrisation.velocities(&output, x, tau)
    }

    /// What the network itself gives at the `last` frames, before the parametrisation is applied:
    /// (B, last, H, W, C). Shapes as in [`Transition::forward`].
    ///
    /// # Errors
    /// If the shapes do not fit the configuration or the pattern, there are fewer frames, or an input is on another device.
    pub fn output(
        &self,
        x: &Tensor,
        tau: &Tensor,
        action: &Tensor,
        pattern: &TemporalPattern,
        last: usize,
    ) -> Result<Tensor> {
        let (b, t) = self.config.check_input(x, tau, action)?;
        self.check_device(x, tau, action)?;
        if pattern.len() != t {
            return Err(Error::Shape {
                what: "the latents",
                expected: format!("(B, {}, H, W, C) for this pattern", pattern.len()),
                found: x.dims().to_vec(),
            });
        }
        if !(1..=t).contains(&last) {
            let reason = format!("{last}, expected 1 to {t}");
            return Err(Error::config("number of last frames", reason));
        }
        let kernels = self.kernels;
        let temporal = Arc::new(pattern.attention(self.config.heads, self.config.head_dim())?);
        let patches = Patches::of(x, self.config.patch)?;
        let mut layers = TensorLayers::new(kernels, b);
        let tokens = self.embedding.tokens(&mut layers, &patches)?;
        let (tau, action) = (tau.flatten_all()?, action.flatten_to(1)?);
        let waves = self.embedding.waves(&tau)?;
        let Network {
            condition,
            blocks,
            head,
        } = &self.network;
        let condition = condition.at(&mut layers, &waves, &action)?;
        let (patterns, activated) = ([&self.spatial, &temporal], &condition.activated);
        let tokens = match &self.gradients {
            Some(gradients) if kernels.takes_kernel(&tokens) => {
                let inputs = (&tokens, activated);
                taped_blocks(blocks, inputs, patterns, last, gradients)?
            }
            _ => run_clips(blocks, &mut layers, tokens, activated, patterns, last)?,
        };
        let Condition { time, activated } = condition.last_frames(&mut layers, last)?;
        let modulation = head.plain_modulation(&mut layers, &activated)?;
        let out = head.forward(&mut layers, &tokens, modulation.as_ref(), &time)?;
        Patches::into_grid(&out, (b, last), &self.config)
    }

    fn check_device(&self, x: &Tensor, tau: &Tensor, action: &Tensor) -> Result<()> {
        let device = self.device();
        for (what, tensor) in [("latents", x), ("tau", tau), ("actions", action)] {
            if !tensor.device().same_device(device) {
                let (found, expected) = (tensor.device().location(), device.location());
                let reason = format!("{what} are on {found:?}, expected {expected:?}");
                return Err(Error::config("device", reason));
            }
        }
        Ok(())
    }

    /// The model ready for inference on the CPU, in f32.
    ///
    /// # Errors
    /// If its tensors cannot be read.
    pub fn pack(&self) -> Result<LoadedTransition> {
        Ok(PackedTransition::new(self, NumberFormat::F32)?.into())
    }
}

#[cfg(test)]
mod tests;
