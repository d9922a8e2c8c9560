//! Convolutions with TensorFlow's padding and a folded BatchNorm.

use candle_core::{DType, Tensor};

use super::depthwise::DepthwiseKernel;
use super::window::Window;
use crate::Result;
use wm_model::{Kernels, NumberFormat};

use crate::layers::{Linear, takes_kernels};
use crate::loader::Loader;
use crate::sizes::shape_error;

/// Epsilon of every BatchNorm.
const BATCH_NORM_EPS: f64 = 1e-3;

/// Sizes of a convolution over all channels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) kernel: usize,
    pub(super) stride: usize,
}

/// A convolution of (N, H, W, C) with a bias.
#[derive(Clone, Debug)]
pub(super) enum Convolution {
    /// 1x1 without a stride.
    Pointwise(Linear),
    /// Any other.
    Spatial(Spatial),
}

/// A convolution with a kernel, over all channels or each by itself.
#[derive(Clone, Debug)]
pub(super) struct Spatial {
    /// (outputs, inputs of a group, kernel, kernel).
    weight: Tensor,
    /// (outputs).
    bias: Tensor,
    window: Window,
    groups: usize,
    kernels: Kernels,
}

impl Convolution {
    /// The convolution and the BatchNorm of these names.
    pub(super) fn load(loader: &Loader<'_>, names: (&str, &str), sizes: Sizes) -> Result<Self> {
        let Sizes {
            inputs,
            outputs,
            kernel,
            stride,
        } = sizes;
        let (weight, bias) = folded(loader, names, [outputs, inputs, kernel, kernel])?;
        if (kernel, stride) == (1, 1) {
            let weight = weight.reshape((outputs, inputs))?;
            return Ok(Self::Pointwise(Linear::new(
                weight,
                Some(bias),
                loader.kernels(),
                // Rounded before the fold; the folded ones are not rounded again.
                NumberFormat::F32,
            )?));
        }
        Ok(Self::Spatial(Spatial {
            weight,
            bias,
            window: Window { kernel, stride },
            groups: 1,
            kernels: loader.kernels(),
        }))
    }

    /// The depthwise convolution and the BatchNorm of these names.
    pub(super) fn load_depthwise(
        loader: &Loader<'_>,
        names: (&str, &str),
        channels: usize,
        (kernel, stride): (usize, usize),
    ) -> Result<Self> {
        let (weight, bias) = folded(loader, names, [channels, 1, kernel, kernel])?;
        Ok(Self::Spatial(Spatial {
            weight,
            bias,
            window: Window { kernel, stride },
            groups: channels,
            kernels: loader.kernels(),
        }))
    }

    /// (N, H, W, inputs) to (N, ceil(H / stride), ceil(W / stride), outputs).
    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Pointwise(linear) => linear.forward(x),
            Self::Spatial(spatial) => spatial.forward(x),
        }
    }
}

impl Spatial {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (_, h, w, _) = x.dims4()?;
        if h == 0 || w == 0 {
            return Err(shape_error("the image", "(N, H, W, C), not empty", x));
        }
        if self.groups > 1 && takes_kernels(self.kernels, x) {
            let kernel = DepthwiseKernel::new(&self.weight, &self.bias, self.window)?;
            return Ok(x.contiguous()?.apply_op1_no_bwd(&kernel)?);
        }
        let ((_, top, bottom), (_, left, right)) = (self.window.along(h), self.window.along(w));
        let padded = x
            .permute((0, 3, 1, 2))?
            .contiguous()?
            .pad_with_zeros(2, top, bottom)?
            .pad_with_zeros(3, left, right)?;
        let y = padded.conv2d(&self.weight, 0, self.window.stride, 1, self.groups)?;
        let y = y.permute((0, 2, 3, 1))?.contiguous()?;
        Ok(y.broadcast_add(&self.bias)?)
    }
}

/// Weight and bias of a convolution with the BatchNorm behind it.
///
/// Only the 1x1 convolutions are rounded to the loader's number format: they hold 86 % of the values. A sum over the few
/// values of a depthwise filter, or of the stem's, averages no rounding out, and a BatchNorm subtracts means that are
/// near its shift: in bf16 these few values would cause most of the error, beyond what bf16 may have.
fn folded(
    loader: &Loader<'_>,
    (convolution, norm): (&str, &str),
    shape: [usize; 4],
) -> Result<(Tensor, Tensor)> {
    let [outputs, _, rows, columns] = shape;
    let unrounded = loader.unrounded();
    let vector = |name: &str| unrounded.tensor(&format!("{norm}.{name}"), &[outputs]);
    let (gain, shift) = (vector("weight")?, vector("bias")?);
    let (mean, variance) = (vector("running_mean")?, vector("running_var")?);
    // A counter of training steps that some files hold.
    loader.ignore(&format!("{norm}.num_batches_tracked"));
    let weights = match (rows, columns) {
        (1, 1) => loader,
        _ => &unrounded,
    };
    let weight = weights.tensor(&format!("{convolution}.weight"), &shape)?;
    let scale = (gain / (variance + BATCH_NORM_EPS)?.sqrt()?)?;
    let bias = (shift - (mean * &scale)?)?;
    let weight = weight
        .to_dtype(DType::F32)?
        .broadcast_mul(&scale.reshape((outputs, 1, 1, 1))?)?;
    Ok((
        weight.to_dtype(loader.dtype())?,
        bias.to_dtype(loader.dtype())?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn padding_is_that_of_tensorflow() {
        let window = |kernel, stride| Window { kernel, stride };
        assert_eq!(window(3, 2).along(256), (128, 0, 1));
        assert_eq!(window(5, 2).along(64), (32, 1, 2));
        assert_eq!(window(5, 1).along(16), (16, 2, 2));
        assert_eq!(window(3, 2).along(5), (3, 1, 1));
        assert_eq!(window(1, 1).along(7), (7, 0, 0));
    }

    #[test]
    fn both_engines_convolve_alike() {
        for (kernel, stride, h, w) in [(3, 1, 5, 4), (3, 2, 6, 7), (5, 2, 8, 5), (5, 1, 3, 2)] {
            let channels = 6;
            let random = |shape: &[usize], seed| wm_model::random::normal(shape, seed).unwrap();
            let x = random(&[2, h, w, channels], 1);
            let mut spatial = Spatial {
                weight: random(&[channels, 1, kernel, kernel], 2),
                bias: random(&[channels], 3),
                window: Window { kernel, stride },
                groups: channels,
                kernels: Kernels::Candle,
            };
            let reference = spatial.forward(&x).unwrap();
            spatial.kernels = Kernels::Cpu;
            let fast = spatial.forward(&x).unwrap();
            assert_eq!(fast.dims(), reference.dims());
            let difference = (fast - reference)
                .unwrap()
                .abs()
                .unwrap()
                .max_all()
                .unwrap();
            assert!(difference.to_scalar::<f32>().unwrap() < 1e-5);
        }
    }
}
