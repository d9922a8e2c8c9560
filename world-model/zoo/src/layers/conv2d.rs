//! Two-dimensional convolution.

use candle_core::{CpuStorage, CustomOp2, Layout, Shape, Tensor};
use wm_model::ops::{self, ConvShape, Epilogue, GridSize};

use super::{Linear, host, takes_kernels};
use crate::{Engine, Result};

/// Rows and columns of zeros around a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Padding {
    /// Rows above.
    pub top: usize,
    /// Rows below.
    pub bottom: usize,
    /// Columns on the left.
    pub left: usize,
    /// Columns on the right.
    pub right: usize,
}

impl Padding {
    /// No border.
    pub const NONE: Self = Self {
        top: 0,
        bottom: 0,
        left: 0,
        right: 0,
    };

    /// One row below and one column on the right: how latent diffusion's autoencoders halve a picture.
    pub const BOTTOM_RIGHT: Self = Self {
        top: 0,
        bottom: 1,
        left: 0,
        right: 1,
    };

    /// What keeps a picture's size under a kernel of `kernel` rows and columns with stride 1.
    pub const fn same(kernel: usize) -> Self {
        let (before, after) = (kernel.saturating_sub(1) / 2, kernel / 2);
        Self {
            top: before,
            bottom: after,
            left: before,
            right: after,
        }
    }

    /// The border's width, if it is the same on all sides.
    fn even(self) -> Option<usize> {
        let Self {
            top,
            bottom,
            left,
            right,
        } = self;
        (top == bottom && top == left && top == right).then_some(top)
    }
}

/// What a convolution does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvSpec {
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// Places from one output's input to the next's.
    pub stride: usize,
    /// Border of zeros.
    pub padding: Padding,
}

impl ConvSpec {
    /// Shape of its weight in checkpoints: (outputs, inputs, kernel, kernel).
    pub fn weight_shape(&self) -> [usize; 4] {
        [self.outputs, self.inputs, self.kernel, self.kernel]
    }

    /// How the kernel of [`wm_model::ops`] computes it, if it can.
    fn plan(&self) -> Option<Plan> {
        if !self.kernel.is_multiple_of(2) && matches!(self.stride, 1 | 2) {
            if self.padding == Padding::same(self.kernel) {
                return Some(Plan::Direct);
            }
            if (self.kernel, self.stride) == (3, 2) && self.padding == Padding::BOTTOM_RIGHT {
                return Some(Plan::Shifted);
            }
        }
        None
    }
}

/// The kernel's border is the same on all sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Plan {
    /// Just what the kernel does.
    Direct,
    /// Border on the lower right only: with one more row above and one more column on the left, each output but the
    /// first of a row or column is what is wanted.
    Shifted,
}

/// A convolution (cross-correlation, as PyTorch's) with bias.
#[derive(Clone, Debug)]
pub struct Conv2d {
    spec: ConvSpec,
    weights: Weights,
    /// (outputs).
    bias: Tensor,
    engine: Engine,
}

#[derive(Clone, Debug)]
enum Weights {
    /// A product at every place.
    Pointwise(Linear),
    /// (kernel row, kernel column, inputs, outputs), for the kernel.
    Packed(Tensor, Plan),
    /// (outputs, inputs, kernel row, kernel column), as in checkpoints.
    Plain(Tensor),
}

impl Conv2d {
    /// `weight` is (outputs, inputs, kernel, kernel), `bias` (outputs).
    ///
    /// # Errors
    /// If the shapes are not those of `spec`, or its stride is 0.
    pub fn new(spec: ConvSpec, weight: &Tensor, bias: Tensor, engine: Engine) -> Result<Self> {
        if weight.dims() != spec.weight_shape() || bias.dims() != [spec.outputs] || spec.stride == 0
        {
            return Err(wm_model::Error::Shape {
                what: "the weight of a convolution",
                expected: format!("{:?}", spec.weight_shape()),
                found: weight.dims().to_vec(),
            }
            .into());
        }
        let pointwise = spec.kernel == 1 && spec.stride == 1 && spec.padding == Padding::NONE;
        let on_kernels = takes_kernels(engine, weight);
        let weights = match spec.plan() {
            _ if pointwise => {
                let weight = weight.reshape((spec.outputs, spec.inputs))?;
                Weights::Pointwise(Linear::new(weight, Some(bias.clone()), engine)?)
            }
            Some(plan) if on_kernels => {
                let mut weight = weight.permute((2, 3, 1, 0))?;
                // A skeleton's weights are one repeated zero, and stay so: it is for counting.
                if weight.stride().iter().any(|stride| *stride != 0) {
                    weight = weight.contiguous()?;
                }
                Weights::Packed(weight, plan)
            }
            _ => Weights::Plain(weight.clone()),
        };
        Ok(Self {
            spec,
            weights,
            bias,
            engine,
        })
    }

    /// `x` (N, H, W, inputs) to (N, H', W', outputs).
    ///
    /// # Errors
    /// If `x` has another number of channels or number format.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (_, height, width, channels) = x.dims4()?;
        let Padding {
            top,
            bottom,
            left,
            right,
        } = self.spec.padding;
        let least = self.spec.kernel;
        if channels != self.spec.inputs
            || height + top + bottom < least
            || width + left + right < least
        {
            return Err(wm_model::Error::Shape {
                what: "the input of a convolution",
                expected: format!(
                    "(N, H, W, {}) of at least {least} x {least} with its border",
                    self.spec.inputs
                ),
                found: x.dims().to_vec(),
            }
            .into());
        }
        match &self.weights {
            Weights::Pointwise(linear) => linear.forward(x),
            Weights::Packed(weight, plan) if takes_kernels(self.engine, x) => {
                self.on_kernel(x, weight, *plan)
            }
            // Weights are packed only in the format that kernels take.
            Weights::Packed(weight, _) => {
                let weight = weight.permute((3, 2, 0, 1))?;
                self.on_candle(x, &weight.to_dtype(x.dtype())?.contiguous()?)
            }
            Weights::Plain(weight) => self.on_candle(x, &weight.contiguous()?),
        }
    }

    fn on_kernel(&self, x: &Tensor, weight: &Tensor, plan: Plan) -> Result<Tensor> {
        let x = match plan {
            Plan::Direct => x.contiguous()?,
            Plan::Shifted => x.pad_with_zeros(1, 1, 0)?.pad_with_zeros(2, 1, 0)?,
        };
        let kernel = Kernel {
            shape: ConvShape {
                inputs: self.spec.inputs,
                outputs: self.spec.outputs,
                kernel: self.spec.kernel,
                stride: self.spec.stride,
                upsample: false,
            },
            bias: self.bias.to_vec1()?,
        };
        let y = x.apply_op2_no_bwd(&weight.contiguous()?, &kernel)?;
        if plan == Plan::Direct {
            return Ok(y);
        }
        let (_, rows, columns, _) = y.dims4()?;
        let y = y.narrow(1, 1, rows - 1)?.narrow(2, 1, columns - 1)?;
        Ok(y.contiguous()?)
    }

    fn on_candle(&self, x: &Tensor, weight: &Tensor) -> Result<Tensor> {
        let padding = self.spec.padding;
        let (x, even) = match padding.even() {
            Some(even) => (x.clone(), even),
            None => {
                let x = x.pad_with_zeros(1, padding.top, padding.bottom)?;
                (x.pad_with_zeros(2, padding.left, padding.right)?, 0)
            }
        };
        let y = x
            .permute((0, 3, 1, 2))?
            .contiguous()?
            .conv2d(weight, even, self.spec.stride, 1, 1)?
            .permute((0, 2, 3, 1))?
            .contiguous()?;
        Ok(y.broadcast_add(&self.bias.to_dtype(y.dtype())?)?)
    }
}

/// [`wm_model::ops::conv2d`].
struct Kernel {
    shape: ConvShape,
    bias: Vec<f32>,
}

impl CustomOp2 for Kernel {
    fn name(&self) -> &'static str {
        "conv2d"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> candle_core::Result<(CpuStorage, Shape)> {
        let (images, height, width, _) = l1.shape().dims4()?;
        let grid = GridSize {
            images,
            height,
            width,
        };
        let (x, weight) = (host::slice(s1, l1)?, host::slice(s2, l2)?);
        let mut y = Vec::new();
        let weights = (weight, Some(self.bias.as_slice()));
        let size = ops::conv2d(&self.shape, weights, x, grid, Epilogue::default(), &mut y)
            .map_err(|error| candle_core::Error::Msg(error.to_string()))?;
        let shape = (size.images, size.height, size.width, self.shape.outputs);
        Ok((CpuStorage::F32(y), Shape::from(shape)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    fn random(shape: &[usize]) -> Tensor {
        Tensor::randn(0f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn both(spec: ConvSpec, size: (usize, usize)) -> [Tensor; 2] {
        let weight = random(&spec.weight_shape());
        let bias = random(&[spec.outputs]);
        let x = random(&[2, size.0, size.1, spec.inputs]);
        [Engine::Candle, Engine::Cpu].map(|engine| {
            let conv = Conv2d::new(spec, &weight, bias.clone(), engine).unwrap();
            conv.forward(&x).unwrap()
        })
    }

    #[test]
    fn both_engines_agree_on_every_border_and_stride() {
        let same = Padding::same;
        let cases = [
            (3, 1, same(3), (6, 5)),
            (1, 1, Padding::NONE, (4, 4)),
            (3, 2, same(3), (7, 6)),
            (5, 1, same(5), (6, 6)),
            (3, 2, Padding::BOTTOM_RIGHT, (6, 8)),
            (3, 2, Padding::BOTTOM_RIGHT, (7, 5)),
            (4, 4, Padding::NONE, (8, 8)),
        ];
        for (kernel, stride, padding, size) in cases {
            let spec = ConvSpec {
                inputs: 3,
                outputs: 5,
                kernel,
                stride,
                padding,
            };
            let [a, b] = both(spec, size);
            assert_eq!(a.dims(), b.dims(), "{spec:?}");
            let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
            let most = difference.to_scalar::<f32>().unwrap();
            assert!(most < 1e-4, "{spec:?} {size:?} differs by {most}");
        }
    }

    #[test]
    fn the_lower_right_border_is_pytorchs() {
        // A kernel that takes the pixel below and to the right of the centre of its 3x3 places.
        let spec = ConvSpec {
            inputs: 1,
            outputs: 1,
            kernel: 3,
            stride: 2,
            padding: Padding::BOTTOM_RIGHT,
        };
        let mut weight = vec![0f32; 9];
        weight[8] = 1.0;
        let weight = Tensor::from_vec(weight, (1, 1, 3, 3), &Device::Cpu).unwrap();
        let bias = Tensor::zeros(1, DType::F32, &Device::Cpu).unwrap();
        let x = Tensor::arange(0f32, 16.0, &Device::Cpu).unwrap();
        let x = x.reshape((1, 4, 4, 1)).unwrap();
        for engine in [Engine::Candle, Engine::Cpu] {
            let conv = Conv2d::new(spec, &weight, bias.clone(), engine).unwrap();
            let y = conv.forward(&x).unwrap().flatten_all().unwrap();
            assert_eq!(y.to_vec1::<f32>().unwrap(), [10.0, 0.0, 0.0, 0.0]);
        }
    }
}
