//! What the network's output stands for.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::Result;

/// Noise levels are not taken below this where the residual parametrisation divides by them.
const SMALLEST_TAU: f64 = 1e-3;

/// What the network's output stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Parametrisation {
    /// The velocity itself, as in the published checkpoints.
    Velocity,
    /// The clean frame less the clean frame before it. An untrained model then predicts that
    /// nothing changes, which small models learn from much faster.
    Residual,
}

impl Parametrisation {
    /// The velocity that `output` of the network stands for at `x` (B, T, H, W, C) of noise levels
    /// `tau` (B, T), given the clean frame before each (`previous`, as `x`).
    ///
    /// # Errors
    /// If the shapes differ.
    pub fn velocity(
        self,
        output: &Tensor,
        x: &Tensor,
        tau: &Tensor,
        previous: &Tensor,
    ) -> Result<Tensor> {
        match self {
            Self::Velocity => Ok(output.clone()),
            Self::Residual => {
                let (b, t) = tau.dims2()?;
                let tau = tau.clamp(SMALLEST_TAU, 1.0)?.reshape((b, t, 1, 1, 1))?;
                let clean = previous.broadcast_add(output)?;
                Ok((x - clean)?.broadcast_div(&tau)?)
            }
        }
    }

    /// As [`Self::velocity`], of a whole window: the frame before each is the one before it in `x`;
    /// the first one has none, and is its own.
    pub(super) fn velocities(self, output: &Tensor, x: &Tensor, tau: &Tensor) -> Result<Tensor> {
        let (_, frames) = tau.dims2()?;
        let previous = match frames {
            1 => x.clone(),
            _ => Tensor::cat(&[x.narrow(1, 0, 1)?, x.narrow(1, 0, frames - 1)?], 1)?,
        };
        self.velocity(output, x, tau, &previous)
    }

    /// Moves `x` from one noise level to the next along the velocity that the network's `output`
    /// stands for; `previous` is the clean frame before.
    pub(crate) fn euler_step(
        self,
        x: &mut [f32],
        output: &[f32],
        previous: &[f32],
        (from, to): (f64, f64),
    ) {
        let step = (from - to) as f32;
        match self {
            Self::Velocity => {
                for (x, velocity) in x.iter_mut().zip(output) {
                    *x -= velocity * step;
                }
            }
            Self::Residual => {
                let tau = from.max(SMALLEST_TAU) as f32;
                for ((x, output), previous) in x.iter_mut().zip(output).zip(previous) {
                    let velocity = (*x - (previous + output)) / tau;
                    *x -= velocity * step;
                }
            }
        }
    }

    /// As [`Self::euler_step`], of tensors of one shape: gives the new `x`.
    pub(super) fn euler_step_of_tensors(
        self,
        x: &Tensor,
        output: &Tensor,
        previous: &Tensor,
        (from, to): (f64, f64),
    ) -> Result<Tensor> {
        let step = from - to;
        Ok(match self {
            Self::Velocity => (x - (output * step)?)?,
            Self::Residual => {
                let ahead = (x - (previous + output)?)?;
                (x - (ahead * (step / from.max(SMALLEST_TAU)))?)?
            }
        })
    }
}
