//! Diffusion forcing, the paper's objective (equation "flow matching" and appendix B.3, "Training hyperparameters"):
//! the frames after the history are noised at once, each at its own level, and see each other.

use anyhow::Result;
use candle_core::{D, DType, Tensor};
use wm_model::transition::{ActionAlignment, TemporalPattern, Transition};

use super::draws::Draws;

/// Mean squared error of the velocity noise - z over the frames after the first `past` of clips (B, n, h, w, C), with the
/// actions (B, n, A) of their frames.
pub(super) fn loss(
    model: &Transition,
    (latents, actions): (&Tensor, &Tensor),
    draws: &Draws,
    past: usize,
) -> Result<Tensor> {
    let (b, n, ..) = latents.dims5()?;
    let later = n - past;
    let history = latents.narrow(1, 0, past)?.contiguous()?;
    let history = draws.as_history(&history)?;
    let target = latents.narrow(1, past, later)?;
    let (noise, tau) = (&draws.noise, &draws.tau);
    let wide = tau.reshape((b, later, 1, 1, 1))?;
    let noisy = (target.broadcast_mul(&(1.0 - &wide)?)? + noise.broadcast_mul(&wide)?)?;

    let frames = Tensor::cat(&[&history, &noisy], 1)?;
    let levels = Tensor::cat(
        &[&Tensor::zeros((b, past), DType::F32, tau.device())?, tau],
        D::Minus1,
    )?;
    let actions = match model.config().action_alignment {
        ActionAlignment::WithFrame => actions.clone(),
        ActionAlignment::WithResult => {
            let first = actions.narrow(1, 0, 1)?.zeros_like()?;
            Tensor::cat(&[first, actions.narrow(1, 0, n - 1)?], 1)?
        }
    };
    let pattern = TemporalPattern::causal(n);
    let output = model.output(&frames, &levels, &actions, &pattern, later)?;
    let velocity = (noise - target)?;
    Ok((output - velocity)?.sqr()?.mean_all()?)
}
