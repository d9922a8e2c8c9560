//! A trial: the time of a prediction on this machine.

use std::time::Duration;

use wm_model::{
    WorldModel,
    sampler::{Noise, Observed, Rollout},
};

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
    let (frame, action) = (
        vec![0.0; model.space.elements()],
        vec![0.0; config.action_dim],
    );
    let frames = context_frames.max(1);
    let observed = [Observed {
        frames: vec![frame.as_slice(); frames],
        actions: vec![action.as_slice(); frames - 1],
        noise: Noise {
            seed: 0,
            first_step: 0,
        },
    }];
    let taken = measured(|| {
        let mut rollout = Rollout::of_values(transition, &sampler, &observed)?;
        (0..STEPS).try_for_each(|_| rollout.predict(&[&action], None).map(|_| ()))
    })?;
    Ok(taken / STEPS)
}
