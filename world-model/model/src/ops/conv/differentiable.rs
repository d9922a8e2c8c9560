//! A convolution that propagates gradients.

use candle_core::{CpuStorage, CustomOp3, Error, Layout, Result, Shape, Tensor};

use super::{
    ConvShape, Fused, GridSize, PackedConv, conv2d_input_gradient, conv2d_weight_gradient,
};
use crate::NumberFormat;
use crate::ops::host::{host, slice};

/// Convolves `x` (images, height, width, inputs) with `weight` (kernel row, kernel column, input channel, output
/// channel) and `bias` (output channel), f32 on the CPU, and propagates gradients to all three by the kernels of this
/// module.
///
/// # Errors
/// If the shapes are not those of `shape`, or a tensor is not f32 on the CPU.
pub fn conv2d(shape: &ConvShape, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let convolution = Convolution(*shape);
    x.contiguous()?
        .apply_op3(&weight.contiguous()?, &bias.contiguous()?, convolution)
}

struct Convolution(ConvShape);

impl Convolution {
    fn grid(&self, x: &Shape) -> Result<GridSize> {
        let (images, height, width, channels) = x.dims4()?;
        if channels != self.0.inputs {
            candle_core::bail!("conv2d: {} channels in {x:?}", self.0.inputs);
        }
        Ok(GridSize {
            images,
            height,
            width,
        })
    }
}

impl CustomOp3 for Convolution {
    fn name(&self) -> &'static str {
        "conv2d"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let grid = self.grid(x_layout.shape())?;
        let packed = PackedConv::new(
            &self.0,
            slice(weight, weight_layout)?,
            Some(slice(bias, bias_layout)?),
            NumberFormat::F32,
        );
        let packed = packed.map_err(Error::wrap)?;
        let mut y = Vec::new();
        let size = packed.run(slice(x, x_layout)?, grid, Fused::default(), &mut y);
        let size = size.map_err(Error::wrap)?;
        let shape = (size.images, size.height, size.width, self.0.outputs);
        Ok((CpuStorage::F32(y), Shape::from(shape)))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        _: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let grid = self.grid(x.shape())?;
        let gradient = gradient.contiguous()?;
        let (hx, hw, hg) = (host(x), host(weight), host(&gradient));
        let (vx, vw, vg) = (hx.values()?, hw.values()?, hg.values()?);
        // What nobody asks for is not computed: pictures and frozen weights have no gradient.
        let by_x = match x.track_op() {
            true => {
                let mut by_x = vec![0.0; vx.len()];
                conv2d_input_gradient(&self.0, vw, vg, grid, None, None, &mut by_x)
                    .map_err(Error::wrap)?;
                Some(Tensor::from_vec(by_x, x.shape(), x.device())?)
            }
            false => None,
        };
        if !weight.track_op() && !bias.track_op() {
            return Ok((by_x, None, None));
        }
        let (mut by_weight, mut by_bias) = (vec![0.0; vw.len()], vec![0.0; self.0.outputs]);
        let of_bias = Some(by_bias.as_mut_slice());
        conv2d_weight_gradient(&self.0, vx, vg, grid, &mut by_weight, of_bias)
            .map_err(Error::wrap)?;
        Ok((
            by_x,
            Some(Tensor::from_vec(by_weight, weight.shape(), x.device())?),
            Some(Tensor::from_vec(by_bias, bias.shape(), x.device())?),
        ))
    }
}
