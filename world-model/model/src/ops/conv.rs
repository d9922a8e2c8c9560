//! Two-dimensional convolution over NHWC activations, forward and backward.
//!
//! Direct convolution: a band of input rows is copied with its zero border into a buffer that stays
//! in the cache, and a register-tiled kernel runs over it. The gradient of the input is again such
//! a convolution (of a stride-2 one, four of them, one for each parity of row and column; behind a
//! doubling, one with stride 2); the gradient of the weights sums outer products in a fixed order.

mod band;
mod differentiable;
mod gradient;
mod packed;
mod phase;
mod sweep;
mod taps;
mod target;
mod tile;
mod winograd;

pub use differentiable::conv2d;
pub use gradient::{conv2d_input_gradient, conv2d_weight_gradient};
pub use packed::PackedConv;

use crate::ops::group_norm::Normalisation;
use crate::{Error, Result};

/// What a convolution does; its border is zeros, `kernel / 2` wide.
///
/// Weights are in the order (kernel row, kernel column, input channel, output channel).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvShape {
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Rows and columns of the kernel, odd.
    pub kernel: usize,
    /// Pixels from one output's input to the next's: 1 or 2.
    pub stride: usize,
    /// Whether the input is first doubled in both directions by nearest neighbour; stride 1 only.
    pub upsample: bool,
}

impl ConvShape {
    /// A convolution with stride 1 that keeps the size.
    pub const fn same(inputs: usize, outputs: usize, kernel: usize) -> Self {
        Self {
            inputs,
            outputs,
            kernel,
            stride: 1,
            upsample: false,
        }
    }

    /// A 3x3 convolution with stride 2.
    pub const fn down(inputs: usize, outputs: usize) -> Self {
        Self {
            inputs,
            outputs,
            kernel: 3,
            stride: 2,
            upsample: false,
        }
    }

    /// Doubling of the size by nearest neighbour, then a 3x3 convolution.
    pub const fn up(inputs: usize, outputs: usize) -> Self {
        Self {
            inputs,
            outputs,
            kernel: 3,
            stride: 1,
            upsample: true,
        }
    }

    /// Number of weights.
    pub const fn weights(&self) -> usize {
        self.kernel * self.kernel * self.inputs * self.outputs
    }

    /// Size of the output for an input of size `grid`.
    pub const fn output(&self, grid: GridSize) -> GridSize {
        let scale = if self.upsample { 2 } else { 1 };
        GridSize {
            images: grid.images,
            height: (grid.height * scale).div_ceil(self.stride),
            width: (grid.width * scale).div_ceil(self.stride),
        }
    }

    /// Floating-point operations for an input of size `grid`, a multiplication and an addition
    /// counted as two.
    pub const fn flops(&self, grid: GridSize) -> usize {
        2 * self.weights() * self.output(grid).pixels()
    }

    fn check(&self) -> Result<()> {
        let fault = if self.kernel.is_multiple_of(2) {
            format!("kernel {} is not odd", self.kernel)
        } else if self.inputs == 0 || self.outputs == 0 {
            format!("{} to {} channels: none", self.inputs, self.outputs)
        } else if !matches!(self.stride, 1 | 2) {
            format!("stride {} is neither 1 nor 2", self.stride)
        } else if self.upsample && self.stride != 1 {
            "upsampling goes with stride 1 only".to_owned()
        } else {
            return Ok(());
        };
        Err(Error::config("convolution", fault))
    }
}

/// Number and size of a batch of images or activations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridSize {
    /// Images.
    pub images: usize,
    /// Rows of each.
    pub height: usize,
    /// Columns of each.
    pub width: usize,
}

impl GridSize {
    /// Pixels of all images.
    pub const fn pixels(&self) -> usize {
        self.images * self.height * self.width
    }
}

/// What is done to inputs and sums on their way.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fused<'a> {
    /// What is done to each image of the input first, without its border.
    pub normalisations: Option<&'a [Normalisation]>,
    /// Added to the result, of the result's shape.
    pub residual: Option<&'a [f32]>,
    /// Whether negative results become zero, after the residual was added.
    pub relu: bool,
}

#[cfg(test)]
mod tests;
