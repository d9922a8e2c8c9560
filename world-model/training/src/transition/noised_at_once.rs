//! Diffusion forcing, the paper's objective (equation "flow matching" and appendix B.3, "Training hyperparameters"): the
//! frames after the history are noised all at once, each at a level of its own, and see each other so.

use anyhow::Result;
use candle_core::{D, DType, Device, Tensor};
use rand_chacha::ChaCha8Rng;
use wm_model::transition::{ActionAlignment, TemporalPattern, Transition};

use super::{
    ClipSource,
    objective::{Objective, normals},
};

/// Mean squared error of the velocity noise - z over the frames after the history.
pub(super) fn loss(
    objective: &Objective,
    model: &Transition,
    clips: &ClipSource<'_>,
    rng: &mut ChaCha8Rng,
) -> Result<Tensor> {
    let (latents, actions) = objective.draw_clips(clips, rng)?;
    let (b, n, ..) = latents.dims5()?;
    let past = objective.recipe.history;
    let later = n - past;
    let history = latents.narrow(1, 0, past)?.contiguous()?;
    let history = objective.with_history_noise(&history, rng)?;
    let target = latents.narrow(1, past, later)?;
    let noise = normals(target.dims(), rng)?;
    let tau: Vec<f32> = (0..b * later).map(|_| objective.draw_tau(rng)).collect();
    let tau = Tensor::from_vec(tau, (b, later), &Device::Cpu)?;
    let wide = tau.reshape((b, later, 1, 1, 1))?;
    let noisy = (target.broadcast_mul(&(1.0 - &wide)?)? + noise.broadcast_mul(&wide)?)?;

    let frames = Tensor::cat(&[&history, &noisy], 1)?;
    let levels = Tensor::cat(
        &[Tensor::zeros((b, past), DType::F32, &Device::Cpu)?, tau],
        D::Minus1,
    )?;
    let actions = match model.config().action_alignment {
        ActionAlignment::WithFrame => actions,
        ActionAlignment::WithResult => {
            let first = actions.narrow(1, 0, 1)?.zeros_like()?;
            Tensor::cat(&[first, actions.narrow(1, 0, n - 1)?], 1)?
        }
    };
    let output = model.output(&frames, &levels, &actions, &TemporalPattern::causal(n))?;
    let velocity = (noise - target)?;
    Ok((output.narrow(1, past, later)? - velocity)?
        .sqr()?
        .mean_all()?)
}
