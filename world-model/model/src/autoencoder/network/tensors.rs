//! The network on tensor operations.

use candle_core::{Device, Tensor};

use super::{BRANCH_EPS, BRANCH_GROUPS, Branch, Conv, Layer, Network};
use crate::{Error, Result};

/// Half an autoencoder on tensor operations, for inference where its tensors are.
#[derive(Clone, Debug)]
pub(in crate::autoencoder) struct TensorNetwork(Vec<TensorLayer>);

#[derive(Clone, Debug)]
enum TensorLayer {
    Conv(TensorConv),
    Block(Box<[TensorConv; 3]>, Option<Box<TensorBranch>>),
}

#[derive(Clone, Debug)]
struct TensorConv {
    /// (output, input, row, column).
    weight: Tensor,
    /// (1, output, 1, 1).
    bias: Option<Tensor>,
    padding: usize,
    stride: usize,
    upsample: bool,
    relu: bool,
}

#[derive(Clone, Debug)]
struct TensorBranch {
    widen: TensorConv,
    /// (1, wide, 1, 1) each.
    scale: Tensor,
    shift: Tensor,
    narrow: TensorConv,
}

impl TensorNetwork {
    /// The network's weights on `device`.
    ///
    /// # Errors
    /// If the device has no memory for them.
    pub(in crate::autoencoder) fn new(network: &Network, device: &Device) -> Result<Self> {
        let conv = |at: usize| match network.convs.get(at) {
            Some(conv) => TensorConv::new(conv, device),
            None => Err(Error::config("network", format!("no convolution {at}"))),
        };
        let layers = network.layers.iter().map(|layer| {
            Ok(match layer {
                Layer::Conv(at) => TensorLayer::Conv(conv(*at)?),
                Layer::Block(first, branch) => {
                    let convs = [conv(*first)?, conv(first + 1)?, conv(first + 2)?];
                    let branch = branch.as_deref().map(|b| TensorBranch::new(b, device));
                    TensorLayer::Block(Box::new(convs), branch.transpose()?.map(Box::new))
                }
            })
        });
        Ok(Self(layers.collect::<Result<_>>()?))
    }

    /// Runs it on `x` (N, H, W, channels), on its device: (N, H', W', channels).
    pub(in crate::autoencoder) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = x.permute((0, 3, 1, 2))?.contiguous()?;
        for layer in &self.0 {
            x = match layer {
                TensorLayer::Conv(conv) => conv.run(&x, None)?,
                TensorLayer::Block(convs, branch) => {
                    if let Some(branch) = branch {
                        x = branch.added_to(&x)?;
                    }
                    let [a, b, c] = &**convs;
                    c.run(&b.run(&a.run(&x, None)?, None)?, Some(&x))?
                }
            };
        }
        Ok(x.permute((0, 2, 3, 1))?.contiguous()?)
    }
}

impl TensorConv {
    fn new(conv: &Conv, device: &Device) -> Result<Self> {
        let shape = conv.shape;
        let kernel = shape.kernel;
        let weight = Tensor::from_slice(
            &conv.weight,
            (kernel, kernel, shape.inputs, shape.outputs),
            &Device::Cpu,
        )?;
        let weight = weight.permute((3, 2, 0, 1))?.contiguous()?;
        Ok(Self {
            weight: weight.to_device(device)?,
            bias: conv
                .bias
                .as_ref()
                .map(|b| channels(b, device))
                .transpose()?,
            padding: kernel / 2,
            stride: shape.stride,
            upsample: shape.upsample,
            relu: conv.relu,
        })
    }

    /// Of `x` (N, channels, H, W); `residual` is added before the ReLU.
    fn run(&self, x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
        let (_, _, height, width) = x.dims4()?;
        let doubled;
        let x = if self.upsample {
            doubled = x.upsample_nearest2d(2 * height, 2 * width)?;
            &doubled
        } else {
            x
        };
        let mut y = x.conv2d(&self.weight, self.padding, self.stride, 1, 1)?;
        if let Some(bias) = &self.bias {
            y = y.broadcast_add(bias)?;
        }
        if let Some(residual) = residual {
            y = (y + residual)?;
        }
        Ok(if self.relu { y.relu()? } else { y })
    }
}

impl TensorBranch {
    fn new(branch: &Branch, device: &Device) -> Result<Self> {
        Ok(Self {
            widen: TensorConv::new(&branch.widen, device)?,
            scale: channels(&branch.scale, device)?,
            shift: channels(&branch.shift, device)?,
            narrow: TensorConv::new(&branch.narrow, device)?,
        })
    }

    fn added_to(&self, x: &Tensor) -> Result<Tensor> {
        let wide = self.widen.run(x, None)?;
        let groups = wide.reshape((wide.dim(0)?, BRANCH_GROUPS, ()))?;
        let centred = groups.broadcast_sub(&groups.mean_keepdim(2)?)?;
        let variance = centred.sqr()?.mean_keepdim(2)?;
        let normed = centred.broadcast_div(&(variance + BRANCH_EPS)?.sqrt()?)?;
        let normed = normed.reshape(wide.shape())?.broadcast_mul(&self.scale)?;
        let normed = normed.broadcast_add(&self.shift)?.relu()?;
        self.narrow.run(&normed, Some(x))
    }
}

/// (1, channels, 1, 1).
fn channels(values: &[f32], device: &Device) -> Result<Tensor> {
    let shape = (1, values.len(), 1, 1);
    Ok(Tensor::from_slice(values, shape, device)?)
}
