//! Predicts many frames, one after the other.

use candle_core::{Device, Tensor};
use wm_model::Compute;
use wm_model::sampler::{Given, Rollout, Sampler};
use wm_model::transition::LoadedTransition;

use super::inputs::Inputs;
use super::{DitConfig, Tensors, finite, owned, parse};
use crate::sizes::shape_error;
use crate::{Checkpoint, Result};

/// How frames are sampled.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutOptions {
    /// Euler steps a frame, time shift, and noise level that context frames are said to have.
    pub sampler: Sampler,
    /// Whether what clean frames contribute to later ones is computed once. Without it every Euler step computes the
    /// whole window again, as the reference implementation does: slower, and the same to rounding.
    pub cache: bool,
}

/// Predicts frames with a transition model: `context` (B,T,H,W,C) observed latents, `actions` (B,T+K,A) of which
/// number i is fed with frame i and leads on from it, `noise` (B,K,H,W,C) that the predicted frames start from; gives
/// `predicted` (B,K,H,W,C). Configuration, weights and `compute` are as for [`forward`](super::forward) of
/// [`Kind::Dit`](super::Kind::Dit).
///
/// # Errors
/// As [`forward`](super::forward), or if the options are not valid.
pub fn rollout(
    config: &str,
    checkpoint: &Checkpoint,
    inputs: &Tensors,
    options: &RolloutOptions,
    compute: &Compute,
) -> Result<Tensors> {
    options.sampler.validate()?;
    let config: DitConfig = parse(config)?;
    let model = config.load(checkpoint, compute)?;
    let inputs = Clips::new(&model, &Inputs::new("dit", inputs, &Device::Cpu))?;
    let predicted = match options.cache {
        true => inputs.predict_cached(&model, &options.sampler)?,
        false => inputs.predict_plainly(&model, &options.sampler)?,
    };
    finite(owned(vec![("predicted", predicted)]))
}

/// Checked inputs.
struct Clips {
    /// (B, T, H, W, C)
    context: Tensor,
    /// (B, T + K, A)
    actions: Tensor,
    /// (B, K, H, W, C)
    noise: Tensor,
    batch: usize,
    observed: usize,
    predicted: usize,
}

impl Clips {
    fn new(model: &LoadedTransition, inputs: &Inputs<'_>) -> Result<Self> {
        let c = model.config();
        let (context, actions) = (inputs.float("context")?, inputs.float("actions")?);
        let noise = inputs.float("noise")?;
        let frame = [c.latent_height, c.latent_width, c.channels];
        let &[batch, observed, ..] = context.dims() else {
            return Err(shape_error("the context", "(B, T, H, W, C)", &context));
        };
        let &[_, predicted, ..] = noise.dims() else {
            return Err(shape_error("the noise", "(B, K, H, W, C)", &noise));
        };
        let with_frame = |first: [usize; 2]| [&first, frame.as_slice()].concat();
        for (what, tensor, expected) in [
            ("the context", &context, with_frame([batch, observed])),
            ("the noise", &noise, with_frame([batch, predicted])),
            (
                "the actions",
                &actions,
                vec![batch, observed + predicted, c.action_dim],
            ),
        ] {
            if tensor.dims() != expected || tensor.elem_count() == 0 {
                let expected = format!("{expected:?}, none of them 0");
                return Err(shape_error(what, expected, tensor));
            }
        }
        Ok(Self {
            context,
            actions,
            noise,
            batch,
            observed,
            predicted,
        })
    }

    /// With the sampler's cache, one clip after the other.
    fn predict_cached(&self, model: &LoadedTransition, sampler: &Sampler) -> Result<Tensor> {
        let clips: Vec<Tensor> = (0..self.batch)
            .map(|clip| {
                let actions = self.actions.get(clip)?;
                let between = match self.observed {
                    1 => None,
                    observed => Some(actions.narrow(0, 0, observed - 1)?),
                };
                let context = self.context.narrow(0, clip, 1)?;
                // The seed is of no effect: all noise is given.
                let mut rollout = Rollout::new(model, sampler, &context, between.as_ref(), 0)?;
                let mut frames = Vec::with_capacity(self.predicted);
                for k in 0..self.predicted {
                    let newest = self.observed + k;
                    let noise = self.noise.narrow(0, clip, 1)?.narrow(1, k, 1)?.squeeze(1)?;
                    let own = actions.narrow(0, newest, 1)?;
                    let given = Given {
                        noise: Some(&noise),
                        own_action: Some(&own),
                    };
                    frames.push(rollout.next_given(&actions.narrow(0, newest - 1, 1)?, given)?);
                }
                Ok(Tensor::stack(&frames, 1)?)
            })
            .collect::<Result<_>>()?;
        Ok(Tensor::cat(&clips, 0)?)
    }

    /// As it is defined: every Euler step computes the whole window.
    fn predict_plainly(&self, model: &LoadedTransition, sampler: &Sampler) -> Result<Tensor> {
        let levels = sampler.levels();
        let mut frames = self.context.clone();
        for k in 0..self.predicted {
            let end = self.observed + k + 1;
            let start = end.saturating_sub(model.config().max_frames);
            let clean = frames.narrow(1, start, end - 1 - start)?;
            let actions = self.actions.narrow(1, start, end - start)?.contiguous()?;
            let mut x = self.noise.narrow(1, k, 1)?;
            for (from, to) in levels.iter().zip(levels.iter().skip(1)) {
                let window = Tensor::cat(&[&clean, &x], 1)?;
                let mut tau = vec![sampler.context_tau as f32; end - start];
                if let Some(last) = tau.last_mut() {
                    *last = *from as f32;
                }
                let tau = Tensor::from_vec(tau, (1, end - start), x.device())?;
                let tau = tau.broadcast_as((self.batch, end - start))?.contiguous()?;
                let velocity = model.forward(&window, &tau, &actions)?;
                let velocity = velocity.narrow(1, end - 1 - start, 1)?;
                x = (x - (velocity * (from - to))?)?;
            }
            frames = Tensor::cat(&[&frames, &x], 1)?;
        }
        Ok(frames
            .narrow(1, self.observed, self.predicted)?
            .contiguous()?)
    }
}
