//! Two-dimensional convolution.

use candle_core::{DType, Tensor};
use wm_model::Kernels;
use wm_model::NumberFormat;
use wm_model::ops::{self, ConvShape, Fused, GridSize, PackedConv};

use super::{GroupNorm, Linear, host, takes_kernels, upsample_nearest_2x};
use crate::Result;

/// Rows and columns of zeros around a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Padding {
    /// Rows above.
    pub(crate) top: usize,
    /// Rows below.
    pub(crate) bottom: usize,
    /// Columns on the left.
    pub(crate) left: usize,
    /// Columns on the right.
    pub(crate) right: usize,
}

impl Padding {
    /// No border.
    pub(crate) const NONE: Self = Self {
        top: 0,
        bottom: 0,
        left: 0,
        right: 0,
    };

    /// One row below and one column on the right: how latent diffusion's autoencoders halve a picture.
    pub(crate) const BOTTOM_RIGHT: Self = Self {
        top: 0,
        bottom: 1,
        left: 0,
        right: 1,
    };

    /// What keeps a picture's size under a kernel of `kernel` rows and columns with stride 1.
    pub(crate) const fn same(kernel: usize) -> Self {
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
pub(crate) struct ConvSpec {
    /// Input channels.
    pub(crate) inputs: usize,
    /// Output channels.
    pub(crate) outputs: usize,
    /// Rows and columns of the kernel.
    pub(crate) kernel: usize,
    /// Places from one output's input to the next's.
    pub(crate) stride: usize,
    /// Border of zeros.
    pub(crate) padding: Padding,
}

impl ConvSpec {
    /// Shape of its weight in checkpoints: (outputs, inputs, kernel, kernel).
    pub(crate) fn weight_shape(&self) -> [usize; 4] {
        [self.outputs, self.inputs, self.kernel, self.kernel]
    }

    /// For the kernels.
    fn shape(&self, upsample: bool) -> ConvShape {
        ConvShape {
            inputs: self.inputs,
            outputs: self.outputs,
            kernel: self.kernel,
            stride: self.stride,
            upsample,
        }
    }

    /// How the kernel of [`wm_model::ops`] computes it, if it can.
    fn plan(&self) -> Option<Plan> {
        if !self.kernel.is_multiple_of(2) && matches!(self.stride, 1 | 2) {
            if self.padding == Padding::same(self.kernel) {
                return Some(Plan::Direct);
            }
            if (self.kernel, self.stride) == (3, 2) && self.padding == Padding::BOTTOM_RIGHT {
                return Some(Plan::LowerRight);
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
    /// Border on the lower right only.
    LowerRight,
}

/// A convolution (cross-correlation, as PyTorch's) with bias.
#[derive(Clone, Debug)]
pub(crate) struct Conv2d {
    spec: ConvSpec,
    weights: Weights,
    /// (outputs).
    bias: Tensor,
    /// Whether the input is doubled first.
    doubles: bool,
}

#[derive(Clone, Debug)]
enum Weights {
    /// A product at every place.
    Pointwise(Linear),
    /// For the kernel.
    Packed(PackedConv),
    /// (outputs, inputs, kernel row, kernel column), as in checkpoints.
    Plain(Tensor),
}

impl Conv2d {
    /// `weight` is (outputs, inputs, kernel, kernel), `bias` (outputs).
    ///
    /// # Errors
    /// If the shapes are not those of `spec`, or its stride is 0.
    pub(crate) fn new(
        spec: ConvSpec,
        weight: &Tensor,
        bias: Tensor,
        kernels: Kernels,
        format: NumberFormat,
    ) -> Result<Self> {
        Self::build((spec, false), weight, bias, kernels, format)
    }

    /// A convolution of a picture that is first doubled in both directions by nearest neighbour.
    ///
    /// # Errors
    /// As [`Conv2d::new`], or if its stride is not 1.
    pub(crate) fn doubling(
        spec: ConvSpec,
        weight: &Tensor,
        bias: Tensor,
        kernels: Kernels,
        format: NumberFormat,
    ) -> Result<Self> {
        Self::build((spec, true), weight, bias, kernels, format)
    }

    fn build(
        (spec, doubles): (ConvSpec, bool),
        weight: &Tensor,
        bias: Tensor,
        kernels: Kernels,
        format: NumberFormat,
    ) -> Result<Self> {
        let shape = |what, expected: String, found: &Tensor| wm_model::Error::Shape {
            what,
            expected,
            found: found.dims().to_vec(),
        };
        if weight.dims() != spec.weight_shape() {
            let expected = format!("{:?}", spec.weight_shape());
            return Err(shape("the weight of a convolution", expected, weight).into());
        }
        if bias.dims() != [spec.outputs] {
            let expected = format!("[{}]", spec.outputs);
            return Err(shape("the bias of a convolution", expected, &bias).into());
        }
        if spec.stride == 0 || (doubles && spec.stride != 1) {
            let reason = format!(
                "{}, expected at least 1, and 1 of a doubled picture",
                spec.stride
            );
            return Err(wm_model::Error::config("stride", reason).into());
        }
        let pointwise =
            !doubles && spec.kernel == 1 && spec.stride == 1 && spec.padding == Padding::NONE;
        // A skeleton's weights are one repeated zero, and stay so: it is for counting.
        let on_kernels = takes_kernels(kernels, weight) && !host::is_repeated(weight);
        let weights = match spec.plan() {
            _ if pointwise => {
                // Not reshaped, which would write a skeleton's repeated zero out.
                let weight = weight.squeeze(3)?.squeeze(2)?;
                Weights::Pointwise(Linear::new(weight, Some(bias.clone()), kernels, format)?)
            }
            Some(plan) if on_kernels => {
                let shape = spec.shape(doubles);
                let bias: Vec<f32> = bias.to_vec1()?;
                let pack = match plan {
                    Plan::Direct => PackedConv::for_inference,
                    Plan::LowerRight => PackedConv::halving_lower_right,
                };
                let packed = host::with_values(&weight.permute((2, 3, 1, 0))?, |weight| {
                    pack(&shape, weight, Some(&bias), format)
                })??;
                Weights::Packed(packed)
            }
            _ => Weights::Plain(weight.clone()),
        };
        Ok(Self {
            spec,
            weights,
            bias,
            doubles,
        })
    }

    /// `x` (N, H, W, inputs) to (N, H', W', outputs).
    ///
    /// # Errors
    /// If `x` has another number of channels or number format.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.check(x)?;
        match &self.weights {
            Weights::Pointwise(linear) => linear.forward(x),
            Weights::Packed(packed) => self.on_kernel(x, packed, (None, None)),
            Weights::Plain(weight) if self.is_trained(x, weight) => {
                let weight = weight.permute((2, 3, 1, 0))?;
                let shape = self.spec.shape(self.doubles);
                Ok(ops::conv2d(&shape, x, &weight, &self.bias)?)
            }
            Weights::Plain(weight) if self.doubles => {
                self.on_candle(&upsample_nearest_2x(x)?, &weight.contiguous()?)
            }
            Weights::Plain(weight) => self.on_candle(x, &weight.contiguous()?),
        }
    }

    /// As [`Conv2d::forward`], plus `residual`, which has the shape of the result.
    ///
    /// # Errors
    /// If `x` has another number of channels or number format, or `residual` another shape.
    pub(crate) fn forward_adding(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.check(x)?;
        match &self.weights {
            Weights::Packed(packed) => self.on_kernel(x, packed, (None, Some(residual))),
            _ => Ok((residual + self.forward(x)?)?),
        }
    }

    /// As [`Conv2d::forward`] of what `norm` and SiLU make of `x`, plus `residual`, which has the shape of the result.
    ///
    /// # Errors
    /// If `x` has another number of channels or number format, or `residual` another shape.
    pub(crate) fn forward_normed(
        &self,
        x: &Tensor,
        norm: &GroupNorm,
        residual: Option<&Tensor>,
    ) -> Result<Tensor> {
        self.check(x)?;
        if let Weights::Packed(packed) = &self.weights {
            let normalisations = norm.silu_normalisations(x)?;
            return self.on_kernel(x, packed, (Some(&normalisations), residual));
        }
        let y = self.forward(&norm.forward_silu(x)?)?;
        match residual {
            Some(residual) => Ok((residual + y)?),
            None => Ok(y),
        }
    }

    fn check(&self, x: &Tensor) -> Result<()> {
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
        Ok(())
    }

    /// Whether gradients are to be propagated on the CPU: candle's take many times as long as our kernels'.
    fn is_trained(&self, x: &Tensor, weight: &Tensor) -> bool {
        let is_tracked = x.track_op() || weight.track_op();
        let fits = x.device().is_cpu() && x.dtype() == DType::F32 && weight.dtype() == DType::F32;
        is_tracked && fits && self.spec.plan() == Some(Plan::Direct)
    }

    fn on_kernel(
        &self,
        x: &Tensor,
        packed: &PackedConv,
        (normalisations, residual): (Option<&[ops::Normalisation]>, Option<&Tensor>),
    ) -> Result<Tensor> {
        let (images, height, width, _) = x.dims4()?;
        let grid = GridSize {
            images,
            height,
            width,
        };
        let mut y = Vec::new();
        let mut run = |residual: Option<&[f32]>| {
            let fused = Fused {
                normalisations,
                residual,
                relu: false,
            };
            host::with_values(x, |x| packed.run(x, grid, fused, &mut y))
        };
        let size = match residual {
            Some(residual) => host::with_values(residual, |residual| run(Some(residual)))?,
            None => run(None),
        }??;
        let shape = (size.images, size.height, size.width, self.spec.outputs);
        Ok(Tensor::from_vec(y, shape, x.device())?)
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

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    fn random(shape: &[usize], seed: u64) -> Tensor {
        wm_model::random::normal(shape, seed).unwrap()
    }

    fn both(spec: ConvSpec, size: (usize, usize)) -> [Tensor; 2] {
        let weight = random(&spec.weight_shape(), 1);
        let bias = random(&[spec.outputs], 2);
        let x = random(&[2, size.0, size.1, spec.inputs], 3);
        [Kernels::Candle, Kernels::Cpu].map(|kernels| {
            let conv =
                Conv2d::new(spec, &weight, bias.clone(), kernels, NumberFormat::F32).unwrap();
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
    fn both_engines_agree_on_a_doubled_picture() {
        let spec = ConvSpec {
            inputs: 3,
            outputs: 5,
            kernel: 3,
            stride: 1,
            padding: Padding::same(3),
        };
        let (weight, bias) = (random(&spec.weight_shape(), 1), random(&[5], 2));
        let x = random(&[2, 5, 4, 3], 3);
        let [a, b] = [Kernels::Candle, Kernels::Cpu].map(|kernels| {
            let conv =
                Conv2d::doubling(spec, &weight, bias.clone(), kernels, NumberFormat::F32).unwrap();
            conv.forward(&x).unwrap()
        });
        assert_eq!(a.dims(), [2, 10, 8, 5]);
        let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
        assert!(difference.to_scalar::<f32>().unwrap() < 1e-4);
    }

    #[test]
    fn gradients_are_candles() {
        for (doubles, stride) in [(false, 1), (true, 1), (false, 2)] {
            let spec = ConvSpec {
                inputs: 3,
                outputs: 5,
                kernel: 3,
                stride,
                padding: Padding::same(3),
            };
            let var = |shape: &[usize], seed| Var::from_tensor(&random(shape, seed)).unwrap();
            let x = var(&[2, 8, 4, 3], 1);
            let (weight, bias) = (var(&spec.weight_shape(), 2), var(&[5], 3));
            let build = if doubles {
                Conv2d::doubling
            } else {
                Conv2d::new
            };
            let format = NumberFormat::F32;
            let of_layer = bias.as_tensor().clone();
            let conv = build(spec, &weight, of_layer, Kernels::Candle, format).unwrap();
            assert!(conv.is_trained(&x, &weight));
            let plain = match doubles {
                true => conv.on_candle(&upsample_nearest_2x(&x).unwrap(), &weight),
                false => conv.on_candle(&x, &weight),
            };
            let of = |y: Tensor| {
                let store = y.sqr().unwrap().sum_all().unwrap().backward().unwrap();
                [&x, &weight, &bias].map(|var| store.get(var).unwrap().clone())
            };
            let pairs = of(conv.forward(&x).unwrap())
                .into_iter()
                .zip(of(plain.unwrap()));
            for (found, expected) in pairs {
                let difference = (&found - &expected).unwrap().abs().unwrap();
                let scalar = |x: Tensor| x.max_all().unwrap().to_scalar::<f32>().unwrap();
                let largest = scalar(expected.abs().unwrap());
                assert!(scalar(difference) < 1e-5 * largest, "{spec:?}");
            }
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
        for kernels in [Kernels::Candle, Kernels::Cpu] {
            let conv =
                Conv2d::new(spec, &weight, bias.clone(), kernels, NumberFormat::F32).unwrap();
            let y = conv.forward(&x).unwrap().flatten_all().unwrap();
            assert_eq!(y.to_vec1::<f32>().unwrap(), [10.0, 0.0, 0.0, 0.0]);
        }
    }
}
