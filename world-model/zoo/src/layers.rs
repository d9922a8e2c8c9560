//! The layers that the models are made of, each with the engine that computes it.
//!
//! Channels are last: (N, H, W, C) for pictures, (.., width) for tokens. Layers come from a [`Loader`](crate::Loader),
//! which knows their weights' names and shapes. A layer takes and gives tensors in the loader's
//! [`dtype`](crate::Loader::dtype).

mod activation;
mod attention;
mod conv2d;
mod dropout;
mod group_norm;
pub(crate) mod host;
mod layer_norm;
mod linear;
mod rms_norm;
mod upsample;

pub(crate) use activation::{Activation, gelu_exact};
pub(crate) use attention::attention;
pub(crate) use conv2d::{Conv2d, ConvSpec, Padding};
pub use dropout::Dropout;
pub(crate) use group_norm::GroupNorm;
pub(crate) use layer_norm::LayerNorm;
pub(crate) use linear::Linear;
pub(crate) use rms_norm::rms_norm;
pub(crate) use upsample::upsample_nearest_2x;

use candle_core::{DType, Tensor};
use wm_model::Kernels;

/// Whether the kernels of [`wm_model::ops`] are to compute `x`, and can.
pub(crate) fn takes_kernels(kernels: Kernels, x: &Tensor) -> bool {
    kernels == Kernels::Cpu && x.dtype() == DType::F32 && x.device().is_cpu()
}
