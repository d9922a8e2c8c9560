//! The operations that networks are made of, whatever computes them.
//!
//! A network is written once, over [`ConvLayers`]. [`ConvKernels`] computes it on kernels of the CPU, [`Tensors`] by candle's
//! operations on any device, and [`Tape`] on the same kernels, with gradients by the weights and the input.

mod conv;
mod kernels;
mod tape;
mod tensors;

pub use conv::Conv;
pub use tape::{ConvGradients, Tape};

pub(crate) use kernels::{Activations, ConvKernels};
pub(crate) use tensors::Tensors;

use crate::Result;

/// What computes the operations of a network.
pub(crate) trait ConvLayers {
    /// A batch of activations.
    type Value;

    /// The convolution of `x`, plus `residual`, then the ReLU if it has one.
    fn conv(
        &mut self,
        conv: &Conv,
        x: &Self::Value,
        residual: Option<&Self::Value>,
    ) -> Result<Self::Value>;

    /// The ReLU of the normalised `x`.
    fn group_norm_relu(&mut self, norm: &GroupNorm, x: Self::Value) -> Result<Self::Value>;
}

/// A group normalisation with its weights.
#[derive(Clone, Debug)]
pub(crate) struct GroupNorm {
    /// Name of its tensors without `.weight` and `.bias`.
    pub(crate) name: String,
    pub(crate) groups: usize,
    /// Added to the variance.
    pub(crate) eps: f64,
    /// Scale and shift of each channel.
    pub(crate) affine: (Vec<f32>, Vec<f32>),
}
