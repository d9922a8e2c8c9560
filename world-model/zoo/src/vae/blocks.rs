//! The pieces of which all convolutional encoders and decoders are made.
//!
//! Source: `docs/architecture.md#encoders` and `#pixel-decoder`; upstream `ldm/modules/diffusionmodules/model.py` of latent
//! diffusion and diffusers' `resnet.py`, which agree. Activations are (N, H, W, C).

use candle_core::Tensor;
use wm_model::{Kernels, NumberFormat};

use super::naming::Naming;
use crate::layers::{Conv2d, ConvSpec, GroupNorm, Linear, Padding, attention};
use crate::{Loader, Result};

/// Added to the variance in every group normalisation.
const NORM_EPS: f64 = 1e-6;

/// What the blocks of one network have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct Family {
    /// Key names.
    pub(super) naming: Naming,
    /// Groups of every group normalisation; see [`Family::norm`].
    pub(super) groups: usize,
    /// Heads of every attention.
    pub(super) heads: usize,
}

impl Family {
    /// A group normalisation. Networks with fewer channels than groups, which only tests have, get a group a
    /// channel.
    fn norm(self, name: &str, channels: usize, loader: &Loader<'_>) -> Result<GroupNorm> {
        loader.group_norm(name, self.groups.min(channels), channels, NORM_EPS)
    }
}

/// GN-SiLU-conv3-GN-SiLU-conv3 beside the identity, or beside a 1x1 convolution where the channels change.
#[derive(Debug)]
pub(super) struct ResBlock {
    norm1: GroupNorm,
    conv1: Conv2d,
    norm2: GroupNorm,
    conv2: Conv2d,
    shortcut: Option<Conv2d>,
}

impl ResBlock {
    pub(super) fn load(
        family: Family,
        inputs: usize,
        outputs: usize,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        let shortcut = (inputs != outputs)
            .then(|| loader.conv2d(family.naming.shortcut(), conv(inputs, outputs, 1)))
            .transpose()?;
        Ok(Self {
            norm1: family.norm("norm1", inputs, loader)?,
            conv1: loader.conv2d("conv1", conv(inputs, outputs, 3))?,
            norm2: family.norm("norm2", outputs, loader)?,
            conv2: loader.conv2d("conv2", conv(outputs, outputs, 3))?,
            shortcut,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let hidden = self.conv1.forward_normed(x, &self.norm1, None)?;
        let shortcut = self.shortcut.as_ref().map(|shortcut| shortcut.forward(x));
        let residual = shortcut.transpose()?;
        let residual = residual.as_ref().unwrap_or(x);
        self.conv2
            .forward_normed(&hidden, &self.norm2, Some(residual))
    }
}

/// A product with a matrix at every place of the grid.
#[derive(Debug)]
enum Pointwise {
    Linear(Linear),
    Convolution(Conv2d),
}

impl Pointwise {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Linear(linear) => linear.forward(x),
            Self::Convolution(convolution) => convolution.forward(x),
        }
    }
}

/// Group normalisation, attention of every place of the grid to every other, and the identity beside it.
#[derive(Debug)]
pub(super) struct AttentionBlock {
    norm: GroupNorm,
    query: Pointwise,
    key: Pointwise,
    value: Pointwise,
    out: Pointwise,
    heads: usize,
    kernels: Kernels,
}

impl AttentionBlock {
    pub(super) fn load(family: Family, channels: usize, loader: &Loader<'_>) -> Result<Self> {
        let names = family.naming.attention();
        let pointwise = |name: &str| -> Result<Pointwise> {
            Ok(if names.convolutions {
                Pointwise::Convolution(loader.conv2d(name, conv(channels, channels, 1))?)
            } else {
                Pointwise::Linear(loader.linear(name, channels, channels)?)
            })
        };
        Ok(Self {
            norm: family.norm(names.norm, channels, loader)?,
            query: pointwise(names.query)?,
            key: pointwise(names.key)?,
            value: pointwise(names.value)?,
            out: pointwise(names.out)?,
            heads: family.heads,
            kernels: loader.kernels(),
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (images, height, width, channels) = x.dims4()?;
        let head_dim = channels / self.heads;
        let normed = self.norm.forward(x)?;
        let heads = |projection: &Pointwise| -> Result<Tensor> {
            Ok(projection
                .forward(&normed)?
                .reshape((images, height * width, self.heads, head_dim))?
                .transpose(1, 2)?)
        };
        let (query, key, value) = (heads(&self.query)?, heads(&self.key)?, heads(&self.value)?);
        let scale = (head_dim as f64).sqrt().recip();
        // In f32: a softmax over a whole picture adds up the rounding of many, and it is a hundredth of the work.
        let compute = (self.kernels, NumberFormat::F32);
        let mixed = attention(compute, [&query, &key, &value], scale, None)?
            .transpose(1, 2)?
            .contiguous()?
            .reshape((images, height, width, channels))?;
        Ok((x + self.out.forward(&mixed)?)?)
    }
}

/// Residual block, attention, residual block at the coarsest size.
#[derive(Debug)]
pub(super) struct Middle {
    first: ResBlock,
    attention: Option<AttentionBlock>,
    second: ResBlock,
}

impl Middle {
    pub(super) fn load(
        family: Family,
        channels: usize,
        with_attention: bool,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        let [first, attention, second] = family.naming.middle();
        let attention = with_attention
            .then(|| AttentionBlock::load(family, channels, &loader.at(attention)))
            .transpose()?;
        Ok(Self {
            first: ResBlock::load(family, channels, channels, &loader.at(first))?,
            attention,
            second: ResBlock::load(family, channels, channels, &loader.at(second))?,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = self.first.forward(x)?;
        if let Some(attention) = &self.attention {
            x = attention.forward(&x)?;
        }
        self.second.forward(&x)
    }
}

/// Residual blocks of one size, attention after some of them.
#[derive(Debug)]
pub(super) struct Level {
    blocks: Vec<(ResBlock, Option<AttentionBlock>)>,
}

impl Level {
    /// Loads `count` blocks, the first of which takes `inputs` channels; `attends` says after which block
    /// there is attention.
    pub(super) fn load(
        family: Family,
        (inputs, outputs): (usize, usize),
        count: usize,
        attends: impl Fn(usize) -> bool,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        let naming = family.naming;
        let mut blocks = Vec::with_capacity(count);
        for index in 0..count {
            let inputs = if index == 0 { inputs } else { outputs };
            let block = ResBlock::load(family, inputs, outputs, &loader.at(naming.block(index)))?;
            let attention = attends(index)
                .then(|| {
                    let loader = loader.at(naming.block_attention(index));
                    AttentionBlock::load(family, outputs, &loader)
                })
                .transpose()?;
            blocks.push((block, attention));
        }
        Ok(Self { blocks })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = x.clone();
        for (block, attention) in &self.blocks {
            x = block.forward(&x)?;
            if let Some(attention) = attention {
                x = attention.forward(&x)?;
            }
        }
        Ok(x)
    }
}

/// Half the size: one row of zeros below and one column to the right, then a 3x3 convolution of stride 2.
#[derive(Debug)]
pub(super) struct Downsample(Conv2d);

impl Downsample {
    pub(super) fn load(family: Family, channels: usize, loader: &Loader<'_>) -> Result<Self> {
        let spec = ConvSpec {
            inputs: channels,
            outputs: channels,
            kernel: 3,
            stride: 2,
            padding: Padding::BOTTOM_RIGHT,
        };
        Ok(Self(loader.conv2d(family.naming.downsample(), spec)?))
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.0.forward(x)
    }
}

/// Double the size: nearest neighbour, then a 3x3 convolution.
#[derive(Debug)]
pub(super) struct Upsample(Conv2d);

impl Upsample {
    pub(super) fn load(family: Family, channels: usize, loader: &Loader<'_>) -> Result<Self> {
        let spec = conv(channels, channels, 3);
        Ok(Self(
            loader.doubling_conv2d(family.naming.upsample(), spec)?,
        ))
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.0.forward(x)
    }
}

/// The end of every network: GN-SiLU-conv3.
#[derive(Debug)]
pub(super) struct Output {
    norm: GroupNorm,
    conv: Conv2d,
}

impl Output {
    pub(super) fn load(
        family: Family,
        inputs: usize,
        outputs: usize,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        Ok(Self {
            norm: family.norm(family.naming.norm_out(), inputs, loader)?,
            conv: loader.conv2d("conv_out", conv(inputs, outputs, 3))?,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.conv.forward_normed(x, &self.norm, None)
    }
}

/// A convolution that keeps the size.
pub(super) fn conv(inputs: usize, outputs: usize, kernel: usize) -> ConvSpec {
    ConvSpec {
        inputs,
        outputs,
        kernel,
        stride: 1,
        padding: Padding::same(kernel),
    }
}
