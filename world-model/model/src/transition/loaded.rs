//! The transition model for inference, whatever computes it.
//!
//! This is the one interface that sampling and planning use. Latents and actions go where the model computes once, as
//! [`Batched`]; what is computed of them stays there until its numbers are asked for.

use candle_core::{DType, Device, Tensor};

use super::values::Batched;
use super::{NewFrame, PackedTransition, TensorTransition, TransitionConfig};
use super::{packed, tensors};
use crate::{Error, Result};

/// The transition model, ready for inference. Clones share everything.
#[derive(Clone, Debug)]
pub enum LoadedTransition {
    /// On kernels of the CPU.
    Packed(PackedTransition),
    /// On tensor operations, which any device has.
    Tensors(TensorTransition),
}

impl From<PackedTransition> for LoadedTransition {
    fn from(model: PackedTransition) -> Self {
        Self::Packed(model)
    }
}

impl From<TensorTransition> for LoadedTransition {
    fn from(model: TensorTransition) -> Self {
        Self::Tensors(model)
    }
}

/// One frame as the temporal attention of later frames sees it: its keys and values in every block, where the model
/// computes.
#[derive(Clone, Debug)]
pub struct FrameContext(Context);

#[derive(Clone, Debug)]
enum Context {
    Packed(packed::FrameContext),
    Tensors(tensors::FrameContext),
}

impl FrameContext {
    /// Number of candidates that it was computed for.
    pub fn batch(&self) -> usize {
        match &self.0 {
            Context::Packed(context) => context.batch(),
            Context::Tensors(context) => context.batch(),
        }
    }
}

/// What noise levels and actions make of every layer, computed for many frames at once.
#[derive(Clone, Debug)]
pub(crate) enum Modulation {
    Packed(packed::Modulation),
    Tensors(tensors::Modulation),
}

impl Modulation {
    /// Frames that it is for.
    pub(crate) fn entries(&self) -> usize {
        match self {
            Self::Packed(modulation) => modulation.entries(),
            Self::Tensors(modulation) => modulation.entries(),
        }
    }
}

/// What a pass gives.
#[derive(Clone, Debug)]
pub struct PassOutput {
    /// The first frames' contexts, as many as were asked for.
    pub contexts: Vec<FrameContext>,
    /// The network's output at the frames that it was asked for, (B, H, W, C) each.
    pub outputs: Vec<Vec<f32>>,
}

/// As [`PassOutput`], with the outputs where the model computes.
pub(crate) struct Computed {
    pub(crate) contexts: Vec<FrameContext>,
    pub(crate) outputs: Vec<Batched>,
}

impl LoadedTransition {
    /// The configuration.
    pub fn config(&self) -> &TransitionConfig {
        match self {
            Self::Packed(model) => model.config(),
            Self::Tensors(model) => model.config(),
        }
    }

    /// What computes it, and where, for messages: `cpu (avx2)`, `cuda:0 in bf16`, ..
    pub fn place(&self) -> String {
        match self {
            Self::Packed(model) => format!("cpu ({})", model.format().kernels()),
            Self::Tensors(model) => model.place(),
        }
    }

    /// The velocity at every frame, as [`Transition::forward`](super::Transition::forward) gives it. Tensors come from
    /// the CPU, and the result is there.
    ///
    /// # Errors
    /// If the shapes do not fit the configuration.
    pub fn forward(&self, x: &Tensor, tau: &Tensor, action: &Tensor) -> Result<Tensor> {
        match self {
            Self::Packed(model) => model.forward(x, tau, action),
            Self::Tensors(model) => model.forward(x, tau, action),
        }
    }

    /// Computes `frames`, in order, after the `earlier` ones, which are at positions 0, 1, ..; each frame sees itself and
    /// all before it. Contexts are given of the first `keep` frames, the network's output of those from `first_output`
    /// on.
    ///
    /// An earlier frame was computed for the same batch, or for a batch of 1, which is then shared.
    ///
    /// # Errors
    /// If sizes do not fit the model or each other, or there are more frames than a window has.
    pub fn pass(
        &self,
        earlier: &[&FrameContext],
        frames: &[NewFrame<'_>],
        keep: usize,
        first_output: usize,
    ) -> Result<PassOutput> {
        let c = self.config();
        let places = c.max_frames.saturating_sub(earlier.len());
        if frames.is_empty() || frames.len() > places {
            return Err(Error::Shape {
                what: "the new frames",
                expected: format!("1 to {places} after {} of {}", earlier.len(), c.max_frames),
                found: vec![frames.len()],
            });
        }
        let held = frames
            .iter()
            .map(|frame| {
                let batch = frame.tau.len();
                let action = self.hold("a new frame's action", batch, frame.action.to_vec())?;
                let latents = self.hold("a new frame", batch, frame.latents.to_vec())?;
                Ok((latents, action))
            })
            .collect::<Result<Vec<_>>>()?;
        let modulated: Vec<_> = frames
            .iter()
            .zip(&held)
            .map(|(frame, (_, action))| (frame.tau, action))
            .collect();
        let modulation = self.modulate(&modulated)?;
        let latents: Vec<_> = held
            .iter()
            .enumerate()
            .map(|(i, (latents, _))| (latents, i))
            .collect();
        let computed = self.pass_modulated(earlier, &latents, &modulation, keep, first_output)?;
        Ok(PassOutput {
            contexts: computed.contexts,
            outputs: computed
                .outputs
                .iter()
                .map(Batched::to_vec)
                .collect::<Result<_>>()?,
        })
    }

    /// `values` (batch, ..), where the model computes.
    ///
    /// # Errors
    /// If they are not as many for each of the batch, or the device has no memory for them.
    pub(crate) fn hold(
        &self,
        what: &'static str,
        batch: usize,
        values: Vec<f32>,
    ) -> Result<Batched> {
        if batch == 0 || !values.len().is_multiple_of(batch) {
            return Err(Error::Shape {
                what,
                expected: format!("a batch of {batch}, at least 1"),
                found: vec![values.len()],
            });
        }
        match self {
            Self::Packed(_) => Ok(Batched::of_slice(batch, values)),
            Self::Tensors(model) => {
                let width = values.len() / batch;
                let values = Tensor::from_vec(values, (batch, width), model.device())?;
                Batched::of_tensor(&values)
            }
        }
    }

    /// As [`Self::hold`], the values of a tensor (batch, ..) on the CPU, which must be finite.
    pub(crate) fn hold_finite(&self, what: &'static str, tensor: &Tensor) -> Result<Batched> {
        let values: Vec<f32> = tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?;
        if values.iter().all(|v| v.is_finite()) {
            self.hold(what, tensor.dim(0)?, values)
        } else {
            Err(Error::NotFinite { what })
        }
    }

    /// The modulation of frames of these noise levels (B each) and actions (B, A each); entry i is that of the i-th.
    ///
    /// # Errors
    /// If there is no frame, or sizes do not fit the model or each other.
    pub(crate) fn modulate(&self, frames: &[(&[f32], &Batched)]) -> Result<Modulation> {
        match self {
            Self::Packed(model) => {
                let frames = frames
                    .iter()
                    .map(|(tau, action)| Ok((*tau, action.slice()?)))
                    .collect::<Result<Vec<_>>>()?;
                Ok(Modulation::Packed(model.modulate(&frames)?))
            }
            Self::Tensors(model) => Ok(Modulation::Tensors(model.modulate(frames)?)),
        }
    }

    /// As [`Self::pass`], without a limit to how many frames there are: for the latents of frames and the entries of
    /// `modulation`, this model's, that are theirs. A modulation can serve several passes, the Euler steps of a frame
    /// above all.
    pub(crate) fn pass_modulated(
        &self,
        earlier: &[&FrameContext],
        frames: &[(&Batched, usize)],
        modulation: &Modulation,
        keep: usize,
        first_output: usize,
    ) -> Result<Computed> {
        match (self, modulation) {
            (Self::Packed(model), Modulation::Packed(modulation)) => {
                let earlier = earlier
                    .iter()
                    .map(|context| match &context.0 {
                        Context::Packed(context) => Ok(context),
                        Context::Tensors(_) => Err(of_another_model()),
                    })
                    .collect::<Result<Vec<_>>>()?;
                let batch = frames.first().map_or(0, |(latents, _)| latents.batch());
                let frames = frames
                    .iter()
                    .map(|(latents, entry)| Ok((latents.slice()?, *entry)))
                    .collect::<Result<Vec<_>>>()?;
                let packed::PassOutput { contexts, outputs } =
                    model.pass_modulated(&earlier, &frames, modulation, keep, first_output)?;
                let contexts = contexts.into_iter().map(Context::Packed);
                let outputs = outputs.into_iter();
                Ok(Computed {
                    contexts: contexts.map(FrameContext).collect(),
                    outputs: outputs.map(|v| Batched::of_slice(batch, v)).collect(),
                })
            }
            (Self::Tensors(model), Modulation::Tensors(modulation)) => {
                let earlier = earlier
                    .iter()
                    .map(|context| match &context.0 {
                        Context::Tensors(context) => Ok(context),
                        Context::Packed(_) => Err(of_another_model()),
                    })
                    .collect::<Result<Vec<_>>>()?;
                let (contexts, outputs) =
                    model.pass_modulated(&earlier, frames, modulation, keep, first_output)?;
                let contexts = contexts.into_iter().map(Context::Tensors);
                Ok(Computed {
                    contexts: contexts.map(FrameContext).collect(),
                    outputs,
                })
            }
            _ => Err(of_another_model()),
        }
    }

    /// Moves `x` from one noise level to the next along the velocity that the network's `output` stands for; `previous`
    /// is the clean frame before.
    pub(crate) fn euler_step(
        &self,
        x: &mut Batched,
        output: &Batched,
        previous: &Batched,
        levels: (f64, f64),
    ) -> Result<()> {
        let parametrisation = self.config().parametrisation;
        match self {
            Self::Packed(_) => {
                let (output, previous) = (output.slice()?, previous.slice()?);
                parametrisation.euler_step(x.slice_mut()?, output, previous, levels);
            }
            Self::Tensors(_) => {
                let (output, previous) = (output.tensor()?, previous.tensor()?);
                let next =
                    parametrisation.euler_step_of_tensors(x.tensor()?, output, previous, levels)?;
                *x = Batched::of_tensor(&next)?;
            }
        }
        Ok(())
    }

    /// `values` (batch, ..) as a tensor of `shape` on the CPU.
    pub(crate) fn tensor_here(values: &Batched, shape: &[usize]) -> Result<Tensor> {
        Ok(Tensor::from_vec(values.to_vec()?, shape, &Device::Cpu)?)
    }
}

fn of_another_model() -> Error {
    Error::Shape {
        what: "an earlier frame's context, or a modulation,",
        expected: "one of this model".into(),
        found: Vec::new(),
    }
}

#[cfg(test)]
mod tests;
