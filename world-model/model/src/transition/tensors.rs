//! The transition model for inference on tensor operations: on a GPU, and on the CPU to hold the same code to the
//! reference where there is no GPU.
//!
//! It computes what [`PackedTransition`](super::PackedTransition) does, for the same interface: what modulates the layers
//! for all Euler steps at once, keys and values of earlier frames once, and all candidates in one batch. Weights are where
//! they were loaded to, and so is all that is computed. Products and attention are in the number format of the weights,
//! everything else is in f32.
//!
//! A pass of few tokens takes a GPU less time than launching its kernels takes the processor. [`Replays`] has the launches
//! of such a pass recorded, and repeats them as one. Whatever else is launched into the device's stream meanwhile would
//! be recorded too: a model that records has a stream of its own, and one thread that uses it at a time.

mod attention;
mod context;
mod modulation;
mod recording;
mod replays;

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{DType, Device, DeviceLocation, Tensor};

use super::embedding::Patches;
use super::values::Batched;
use super::{Transition, TransitionConfig};
use crate::Kernels;
use crate::ops::RotaryTable;
use crate::ops::token_layers::{ClipLayers as _, TensorLayers};
use crate::{Error, Result};
use attention::{Angles, Heads};
pub(super) use context::FrameContext;
use context::{Earlier, Kept, KeysValues};
pub(super) use modulation::Modulation;
use modulation::OfFrames;
use replays::Replays;

/// What computes.
const KERNELS: Kernels = Kernels::Candle;

/// The transition model on tensor operations. Clones share everything.
#[derive(Clone, Debug)]
pub struct TensorTransition(Arc<Parts>);

#[derive(Debug)]
struct Parts {
    model: Transition,
    heads: Heads,
    /// Angles of the tokens of a frame.
    in_space: Angles,
    /// Angles of all positions of a window.
    in_time: Angles,
    /// Of the last pass: the Euler steps of a frame have the same ones.
    earlier: Mutex<Option<Arc<Earlier>>>,
    /// None: passes are not recorded.
    replays: Option<Mutex<Replays>>,
}

/// What a pass is computed from.
#[derive(Clone, Debug)]
struct Inputs {
    /// (B, F, H, W, C).
    latents: Tensor,
    modulation: OfFrames,
    earlier: Arc<Earlier>,
}

/// The first frames' keys and values, block by block, and the network's output at the last ones.
struct Outcome {
    kept: Vec<KeysValues>,
    /// (B, frames, H, W, C).
    output: Option<Tensor>,
}

impl TensorTransition {
    /// The model as it is, where its tensors are; with `recorded`, passes of few tokens are recorded and repeated, where
    /// the device can.
    ///
    /// # Errors
    /// If the device has no memory left.
    pub fn new(model: Transition, recorded: bool) -> Result<Self> {
        let model = model.plain();
        let c = model.config();
        let positions: Vec<usize> = (0..c.max_frames).collect();
        let in_time = RotaryTable::sequence(&positions, c.head_dim());
        let device = model.device();
        Ok(Self(Arc::new(Parts {
            heads: Heads {
                count: c.heads,
                dim: c.head_dim(),
            },
            in_space: c.rotary().tensors(device)?,
            in_time: in_time.tensors(device)?,
            earlier: Mutex::default(),
            replays: recorded.then(Mutex::default),
            model,
        })))
    }

    /// The configuration.
    pub fn config(&self) -> &TransitionConfig {
        self.0.model.config()
    }

    /// Where it computes.
    pub fn device(&self) -> &Device {
        self.0.model.device()
    }

    /// Device and number format, for messages.
    pub(super) fn place(&self) -> String {
        let device = match self.device().location() {
            DeviceLocation::Cpu => "cpu, on tensor operations,".to_owned(),
            DeviceLocation::Cuda { gpu_id } => format!("cuda:{gpu_id}"),
            DeviceLocation::Metal { gpu_id } => format!("metal:{gpu_id}"),
        };
        let format = self.0.model.embedding.patch_weight.dtype();
        format!("{device} in {}", format.as_str())
    }

    /// As [`super::LoadedTransition::forward`].
    ///
    /// # Errors
    /// If the shapes do not fit the configuration.
    pub fn forward(&self, x: &Tensor, tau: &Tensor, action: &Tensor) -> Result<Tensor> {
        let here = |tensor: &Tensor| tensor.to_dtype(DType::F32)?.to_device(self.device());
        let (x, tau, action) = (here(x)?, here(tau)?, here(action)?);
        let velocity = self.0.model.forward(&x, &tau, &action)?;
        Ok(velocity.to_device(&Device::Cpu)?)
    }

    /// As [`super::LoadedTransition::modulate`].
    pub(super) fn modulate(&self, frames: &[(&[f32], &Batched)]) -> Result<Modulation> {
        Modulation::new(&self.0.model, frames)
    }

    /// As [`super::LoadedTransition::pass_modulated`].
    pub(super) fn pass_modulated(
        &self,
        earlier: &[&FrameContext],
        frames: &[(&Batched, usize)],
        modulation: &Modulation,
        keep: usize,
        first_output: usize,
    ) -> Result<(Vec<FrameContext>, Vec<Batched>)> {
        let (c, batch) = (self.config(), modulation.batch());
        let entries: Vec<usize> = frames.iter().map(|(_, entry)| *entry).collect();
        let earlier = self.earlier(earlier, batch)?;
        let grid = (batch, c.latent_height, c.latent_width, c.channels);
        let latent = c.latent_height * c.latent_width * c.channels;
        let mut latents = Vec::with_capacity(frames.len());
        for (frame, entry) in frames {
            let values = frame.tensor()?;
            if values.dims() != [batch, latent] || *entry >= modulation.entries() {
                return Err(Error::Shape {
                    what: "a new frame",
                    expected: format!(
                        "{} values, and one of {} entries of the modulation",
                        batch * latent,
                        modulation.entries()
                    ),
                    found: vec![values.elem_count(), *entry],
                });
            }
            latents.push(values.reshape(grid)?);
        }
        let inputs = Inputs {
            latents: Tensor::stack(&latents, 1)?,
            modulation: modulation.of(&entries)?,
            earlier,
        };
        let keep = keep.min(frames.len());
        let Outcome { kept, output } = match &self.0.replays {
            Some(replays) if Replays::take(&inputs, c.tokens(), keep, first_output) => {
                let mut replays = replays.lock().unwrap_or_else(PoisonError::into_inner);
                let output = replays.run(self.device(), inputs, |inputs| self.output(inputs))?;
                Outcome {
                    kept: Vec::new(),
                    output: Some(output),
                }
            }
            _ => self.compute(&inputs, keep, first_output)?,
        };
        let kept = Arc::new(Kept::new(Arc::clone(&self.0), batch, kept));
        let contexts = (0..keep).map(|index| FrameContext::new(&kept, index));
        let outputs = match output {
            None => Vec::new(),
            Some(output) => (0..output.dim(1)?)
                .map(|t| Batched::of_tensor(&output.narrow(1, t, 1)?.contiguous()?))
                .collect::<Result<_>>()?,
        };
        Ok((contexts.collect(), outputs))
    }

    /// The contexts of earlier frames side by side.
    fn earlier(&self, contexts: &[&FrameContext], batch: usize) -> Result<Arc<Earlier>> {
        for context in contexts {
            if !context.is_of(&self.0) || ![1, batch].contains(&context.batch()) {
                return Err(Error::Shape {
                    what: "an earlier frame's context",
                    expected: format!("one of this model, for a batch of 1 or {batch}"),
                    found: vec![context.batch()],
                });
            }
        }
        let mut last = self
            .0
            .earlier
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        match &*last {
            Some(earlier) if earlier.is_of(contexts, batch) => Ok(Arc::clone(earlier)),
            _ => {
                // The old one goes before there is memory for another.
                *last = None;
                let new = Arc::new(Earlier::new(contexts, batch, self.config().depth)?);
                Ok(Arc::clone(last.insert(new)))
            }
        }
    }

    /// The network's output at a single new frame, (B, 1, H, W, C).
    fn output(&self, inputs: &Inputs) -> Result<Tensor> {
        let output = self.compute(inputs, 0, 0)?.output;
        output.ok_or_else(|| Error::config("frames", "none was computed"))
    }

    fn compute(&self, inputs: &Inputs, keep: usize, first_output: usize) -> Result<Outcome> {
        let Parts {
            model,
            heads,
            in_space,
            in_time,
            ..
        } = &*self.0;
        let (c, modulation, earlier) = (model.config(), &inputs.modulation, &inputs.earlier);
        let (batch, frames, ..) = inputs.latents.dims5()?;
        let at = |angles: &Tensor| angles.narrow(0, earlier.frames(), frames);
        let in_time = (at(&in_time.0)?, at(&in_time.1)?);
        let patches = Patches::of(&inputs.latents, c.patch)?;
        let mut layers = TensorLayers::new(KERNELS, batch);
        let mut tokens = model.embedding.tokens(&mut layers, &patches)?;
        let mut block_layers = layers.in_format(model.embedding.patch_weight.dtype());
        let mut kept = Vec::with_capacity(model.network.blocks.len());
        for (index, (block, earlier)) in model
            .network
            .blocks
            .iter()
            .zip(earlier.layers())
            .enumerate()
        {
            let (layers, [spatial, temporal]) = (&mut block_layers, block);
            let by_space = modulation.sub_blocks.get(2 * index)?;
            let qkv = spatial.project(layers, &tokens, &by_space)?;
            let attended = heads.attend_in_space(&qkv, in_space)?;
            tokens = spatial.finish(layers, tokens, &attended, &by_space)?;
            let by_time = modulation.sub_blocks.get(2 * index + 1)?;
            let qkv = temporal.project(layers, &tokens, &by_time)?;
            let (attended, own) = heads.attend_in_time(&qkv, &in_time, earlier)?;
            if keep > 0 {
                kept.push(own.first(keep)?);
            }
            tokens = temporal.finish(layers, tokens, &attended, &by_time)?;
        }
        let count = frames.saturating_sub(first_output);
        if count == 0 {
            return Ok(Outcome { kept, output: None });
        }
        let tokens = tokens.narrow(1, first_output, count)?.contiguous()?;
        let mut last = |rows: &Tensor| layers.last_frames(rows.clone(), count);
        let (of_head, time) = (
            modulation.head.as_ref().map(&mut last),
            last(&modulation.time)?,
        );
        let of_head = of_head.transpose()?;
        let patches = model
            .network
            .head
            .forward(&mut layers, &tokens, of_head.as_ref(), &time)?;
        let output = Patches::into_grid(&patches, (batch, count), c)?;
        Ok(Outcome {
            kept,
            output: Some(output),
        })
    }
}

#[cfg(test)]
mod tests;
