//! The feed-forward half of a block.

use candle_core::Tensor;
use wm_model::Kernels;
use wm_model::ops::swiglu;

use crate::Result;
use crate::layers::{Activation, Linear};

/// A feed-forward network.
#[derive(Clone, Debug)]
pub(crate) enum Mlp {
    /// Linear, activation, linear.
    Plain {
        first: Linear,
        activation: Activation,
        second: Linear,
    },
    /// Linear to twice the width, silu(first half) * second half, linear.
    SwiGlu {
        gate_and_value: Linear,
        out: Linear,
        kernels: Kernels,
    },
}

impl Mlp {
    /// (.., width) to (.., hidden): all but the last product.
    pub(crate) fn hidden(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Plain {
                first, activation, ..
            } => first.forward_activated(x, *activation),
            Self::SwiGlu {
                gate_and_value,
                kernels,
                ..
            } => Ok(swiglu(*kernels, &gate_and_value.forward(x)?)?),
        }
    }

    /// The last product, of what [`Self::hidden`] gives.
    pub(crate) fn out(&self) -> &Linear {
        match self {
            Self::Plain { second, .. } => second,
            Self::SwiGlu { out, .. } => out,
        }
    }
}
