//! Tensor operations that the stock library is slow at, each with its exact gradient.
//!
//! Activations are plain slices in NHWC order (image, row, column, channel); work is spread over
//! the threads of rayon, and results do not depend on how many there are.

mod attention;
mod cached_attention;
mod conv;
mod exponential;
mod gated_residual;
mod group_norm;
mod host;
mod linear;
mod rms_norm_modulate;
mod rotary;
mod simd;
mod swiglu;
mod vectorised;

pub use attention::{AttentionPattern, Axis, HEAD_DIM_MULTIPLE, attention};
pub use cached_attention::{FrameKeys, cached_attention};
pub use conv::{
    ConvShape, Epilogue, GridSize, conv2d, conv2d_input_gradient, conv2d_weight_gradient,
};
pub use gated_residual::gated_residual;
pub use group_norm::group_norm;
pub use linear::linear;
pub use rms_norm_modulate::rms_norm_modulate;
pub use rotary::RotaryTable;
pub use swiglu::swiglu;
