//! Tensor operations that the stock library is slow at.
//!
//! Those for training take tensors and the [`Kernels`](crate::Kernels) that compute, and have exact gradients on both kinds: our kernels,
//! or candle's operations for other devices than the CPU and for reference. Those for inference
//! ([`PackedLinear`], `block_attention`, `temporal_attention`) take plain slices, and weights that
//! were packed once. Activations of convolutions are in NHWC order (image, row, column, channel).
//! Work is spread over the threads of rayon, and results do not depend on how many there are.

pub(crate) mod activation;
mod attention;
pub(crate) mod block_attention;
pub(crate) mod buffer;
#[cfg(test)]
mod comparison;
mod conv;
pub(crate) mod conv_layers;
mod dense_attention;
pub(crate) mod element;
pub(crate) mod exponential;
pub(crate) mod gated_residual;
mod group_norm;
pub(crate) mod host;
mod input_range;
mod int8_panels;
pub(crate) mod kernel;
mod layer_norm;
mod length;
pub(crate) mod linear;
mod packed_linear;
mod panel_product;
mod panel_values;
mod panels;
mod peak;
pub(crate) mod product;
mod reduction;
pub(crate) mod rms_norm_modulate;
mod rotary;
pub(crate) mod simd;
mod smoothing;
mod softmax;
pub(crate) mod swiglu;
pub(crate) mod temporal_attention;
pub(crate) mod token_layers;
mod uncleared;
pub(crate) mod vectorised;

pub use activation::{gelu_exact, gelu_tanh, silu};
pub(crate) use attention::{AttentionPattern, Axis, HEAD_DIM_MULTIPLE, attention};
pub use conv::{
    ConvShape, Fused, GridSize, PackedConv, conv2d, conv2d_input_gradient, conv2d_weight_gradient,
};
pub use conv_layers::{Conv, ConvGradients, Tape};
pub use dense_attention::{AttentionShape, HeadRows, ScoreMask, dense_attention};
pub(crate) use gated_residual::gated_residual;
pub use group_norm::{
    Activation, Normalisation, differentiable_group_norm, group_norm, group_normalisations,
};
pub use input_range::InputRange;
pub use layer_norm::layer_norm;
pub use linear::{linear, scale_and_add_rows};
pub use packed_linear::{PackedLinear, packed_layout};
pub use panel_values::MappedBytes;
pub use peak::peak_rate;
pub(crate) use rms_norm_modulate::rms_norm_modulate;
pub use rotary::RopeLayout;
pub(crate) use rotary::{RotaryTable, normalise_and_rotate_plain};
pub use smoothing::Smoothing;
pub use swiglu::swiglu;
