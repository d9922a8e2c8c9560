//! A trial: the time of a prediction on this machine.

use std::time::Duration;

use candle_core::{DType, Device, Tensor};
use wm_model::{WorldModel, sampler::Rollout};

use crate::cadence::measured;

/// Steps of the trial: the first one computes the context's keys and values too.
const STEPS: u32 = 2;

/// The time per predicted frame with `integration_steps` Euler steps, from a context of `context_frames` empty frames.
///
/// # Errors
/// Where the model cannot compute it.
pub(super) fn time_of_step(
    model: &WorldModel,
    context_frames: usize,
    integration_steps: usize,
) -> wm_model::Result<Duration> {
    let transition = &model.transition;
    let config = transition.config();
    let mut sampler = config.sampler.clone();
    sampler.steps = integration_steps;
    let ((height, width, channels), frames) = (model.space.shape(), context_frames.max(1));
    let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu);
    let context = zeros(&[1, frames, height, width, channels])?;
    let past = match frames {
        1 => None,
        frames => Some(zeros(&[frames - 1, config.action_dim])?),
    };
    let action = zeros(&[1, config.action_dim])?;
    let taken = measured(|| {
        let mut rollout = Rollout::new(transition, &sampler, &context, past.as_ref(), 0)?;
        (0..STEPS).try_for_each(|_| rollout.next(&action).map(|_| ()))
    })?;
    Ok(taken / STEPS)
}
