//! One half of an autoencoder: a chain of convolutions and residual blocks.

use candle_core::{Device, Tensor};
use rand::Rng;
use sha2::{Digest, Sha256};

use crate::ops::conv_layers::{
    Activations, Conv, ConvKernels, ConvLayers, GroupNorm, Tape, Tensors,
};
use crate::ops::{ConvShape, GridSize};
use crate::weights::{Precision, WeightsBuilder, hash_tensor_header};
use crate::{Result, Weights};

/// Groups of the branch's normalisation.
const BRANCH_GROUPS: usize = 4;
/// Width of the branch, as a multiple of the block's.
const BRANCH_FACTOR: usize = 4;
const BRANCH_EPS: f64 = 1e-5;

/// A layer, before it has weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// A convolution.
    Conv {
        name: String,
        shape: ConvShape,
        bias: bool,
        relu: bool,
    },
    /// relu(conv(relu(conv(relu(conv(x))))) + x), where a branch first adds to x.
    Block {
        name: String,
        width: usize,
        branch: bool,
    },
}

/// The branch of a residual block.
#[derive(Clone, Debug)]
struct Branch {
    widen: Conv,
    norm: GroupNorm,
    narrow: Conv,
}

#[derive(Clone, Debug)]
enum Layer {
    Conv(Box<Conv>),
    Block(Box<[Conv; 3]>, Option<Box<Branch>>),
}

/// Half an autoencoder.
#[derive(Clone, Debug)]
pub struct Network {
    layers: Vec<Layer>,
    /// The weights on a device, if candle's operations compute it.
    tensors: Option<Tensors>,
}

/// Where weights come from.
trait Source {
    /// A convolution's weight in the order of [`ConvShape`].
    fn weight(&mut self, name: &str, shape: &ConvShape, gain: f32) -> Result<Vec<f32>>;
    /// A vector that starts as `start`.
    fn vector(&mut self, name: &str, length: usize, start: f32) -> Result<Vec<f32>>;

    /// A convolution with the ReLU or without.
    fn conv(
        &mut self,
        name: String,
        (shape, relu): (ConvShape, bool),
        bias: bool,
        gain: f32,
    ) -> Result<Conv> {
        let weight = self.weight(&format!("{name}.weight"), &shape, gain)?;
        let bias = bias
            .then(|| self.vector(&format!("{name}.bias"), shape.outputs, 0.0))
            .transpose()?;
        Ok(Conv::new(name, (shape, relu), weight, bias))
    }
}

struct Stored<'a> {
    weights: &'a Weights,
    prefix: &'a str,
}

impl Source for Stored<'_> {
    fn weight(&mut self, name: &str, shape: &ConvShape, _: f32) -> Result<Vec<f32>> {
        let name = format!("{}{name}", self.prefix);
        let dims = [shape.outputs, shape.inputs, shape.kernel, shape.kernel];
        let stored = self.weights.values(&name, &dims)?;
        Ok(Conv::from_checkpoint(shape, &stored))
    }

    fn vector(&mut self, name: &str, length: usize, _: f32) -> Result<Vec<f32>> {
        self.weights
            .values(&format!("{}{name}", self.prefix), &[length])
    }
}

struct Random<'a, R: Rng>(&'a mut R);

impl<R: Rng> Source for Random<'_, R> {
    fn weight(&mut self, _: &str, shape: &ConvShape, gain: f32) -> Result<Vec<f32>> {
        let fan_in = shape.kernel * shape.kernel * shape.inputs;
        // Uniform with the variance 2 / fan_in that keeps activations level through ReLUs.
        let bound = gain * (6.0 / fan_in as f32).sqrt();
        Ok((0..shape.weights())
            .map(|_| self.0.random_range(-bound..bound))
            .collect())
    }

    fn vector(&mut self, _: &str, length: usize, start: f32) -> Result<Vec<f32>> {
        Ok(vec![start; length])
    }
}

impl Network {
    /// Loads the tensors whose names begin with `prefix`.
    pub(super) fn load(stages: &[Stage], weights: &Weights, prefix: &str) -> Result<Self> {
        Self::build(stages, &mut Stored { weights, prefix })
    }

    /// Random weights with which training starts.
    pub(super) fn random(stages: &[Stage], rng: &mut impl Rng) -> Result<Self> {
        Self::build(stages, &mut Random(rng))
    }

    fn build(stages: &[Stage], source: &mut impl Source) -> Result<Self> {
        let layers = stages.iter().map(|stage| {
            Ok(match stage {
                Stage::Conv {
                    name,
                    shape,
                    bias,
                    relu,
                } => {
                    // Without a ReLU behind it, half the variance keeps the level.
                    let gain = if *relu { 1.0 } else { 0.7 };
                    Layer::Conv(Box::new(source.conv(
                        name.clone(),
                        (*shape, *relu),
                        *bias,
                        gain,
                    )?))
                }
                Stage::Block {
                    name,
                    width,
                    branch,
                } => {
                    let shape = ConvShape::same(*width, *width, 3);
                    // A small last convolution lets a deep chain start near the identity.
                    let mut conv = |i: usize, gain: f32| {
                        source.conv(format!("{name}.conv.{i}"), (shape, true), true, gain)
                    };
                    let convs = [conv(0, 1.0)?, conv(2, 1.0)?, conv(4, 0.3)?];
                    let branch = branch.then(|| Branch::build(source, name, *width));
                    Layer::Block(Box::new(convs), branch.transpose()?.map(Box::new))
                }
            })
        });
        Ok(Self {
            layers: layers.collect::<Result<_>>()?,
            tensors: None,
        })
    }

    /// What it computes of `x`.
    fn forward<L: ConvLayers>(&self, layers: &mut L, mut x: L::Value) -> Result<L::Value> {
        for layer in &self.layers {
            x = match layer {
                Layer::Conv(conv) => layers.conv(conv, &x, None)?,
                Layer::Block(convs, branch) => {
                    if let Some(branch) = branch {
                        let wide = layers.conv(&branch.widen, &x, None)?;
                        let wide = layers.group_norm_relu(&branch.norm, wide)?;
                        x = layers.conv(&branch.narrow, &wide, Some(&x))?;
                    }
                    let [first, second, third] = &**convs;
                    let mut hidden = layers.conv(first, &x, None)?;
                    hidden = layers.conv(second, &hidden, None)?;
                    layers.conv(third, &hidden, Some(&x))?
                }
            };
        }
        Ok(x)
    }

    /// The output for `input` (grid, channels), on kernels of the CPU or on the device of its tensors.
    pub(super) fn run(&self, input: Vec<f32>, grid: GridSize) -> Result<Vec<f32>> {
        let Some(mut tensors) = self.tensors.as_ref() else {
            let values = input;
            let mut output = self.forward(&mut ConvKernels, Activations { values, grid })?;
            let mut values = std::mem::take(&mut output.values);
            // Its memory may have served a wider layer.
            values.shrink_to_fit();
            return Ok(values);
        };
        let shape = (grid.images, grid.height, grid.width, ());
        let input = Tensor::from_vec(input, shape, tensors.device())?;
        let input = input.permute((0, 3, 1, 2))?.contiguous()?;
        let output = self.forward(&mut tensors, input)?;
        let output = output.permute((0, 2, 3, 1))?.contiguous()?;
        Ok(output.to_device(&Device::Cpu)?.flatten_all()?.to_vec1()?)
    }

    /// The output for `input` (grid, channels); `tape` keeps what its backward pass needs.
    ///
    /// # Errors
    /// If the network has a branch, which cannot be trained, or the input does not fit it.
    pub fn record<'t>(
        &self,
        tape: &'t mut Tape,
        input: &[f32],
        grid: GridSize,
    ) -> Result<&'t [f32]> {
        let input = tape.begin(input, grid);
        let output = self.forward(tape, input)?;
        Ok(tape.value(output))
    }

    /// Copies the weights to `device`, where candle's operations compute the network from now on.
    pub(super) fn place_on(&mut self, device: &Device) -> Result<()> {
        let mut tensors = Tensors::new(device);
        let mut fault = Ok(());
        self.visit(|name, shape, values| {
            if fault.is_ok() {
                fault = tensors.insert(name, shape, values);
            }
        });
        fault?;
        self.tensors = Some(tensors);
        Ok(())
    }

    /// The convolutions in order, without those of branches.
    pub fn convs(&self) -> impl Iterator<Item = &Conv> {
        self.layers.iter().flat_map(|layer| match layer {
            Layer::Conv(conv) => std::slice::from_ref(&**conv),
            Layer::Block(convs, _) => convs.as_slice(),
        })
    }

    /// The convolutions in order, to change their weights. Afterwards kernels of the CPU compute the network.
    pub fn convs_mut(&mut self) -> impl Iterator<Item = &mut Conv> {
        self.tensors = None;
        let convs = self.layers.iter_mut().flat_map(|layer| match layer {
            Layer::Conv(conv) => std::slice::from_mut(&mut **conv),
            Layer::Block(convs, _) => convs.as_mut_slice(),
        });
        convs.map(Conv::forget_packed)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        let mut count = 0;
        self.visit(|_, _, values| count += values.len());
        count
    }

    /// Floating-point operations of the convolutions for an input of size `grid`.
    pub fn flops(&self, mut grid: GridSize) -> usize {
        let mut total = 0;
        for conv in self.convs() {
            total += conv.shape.flops(grid);
            grid = conv.shape.output(grid);
        }
        total
    }

    fn branches(&self) -> impl Iterator<Item = &Branch> {
        self.layers.iter().filter_map(|layer| match layer {
            Layer::Block(_, Some(branch)) => Some(&**branch),
            _ => None,
        })
    }

    /// Every tensor by name, with the shape and in the order of the published files.
    fn visit(&self, mut tensor: impl FnMut(String, &[usize], &[f32])) {
        let branches = self.branches().flat_map(|b| [&b.widen, &b.narrow]);
        for conv in self.convs().chain(branches) {
            let (shape, weight) = conv.to_checkpoint();
            tensor(format!("{}.weight", conv.name), &shape, &weight);
            if let Some(bias) = &conv.bias {
                tensor(format!("{}.bias", conv.name), &[bias.len()], bias);
            }
        }
        for Branch { norm, .. } in self.branches() {
            let (scale, shift) = &norm.affine;
            for (end, values) in [("weight", scale), ("bias", shift)] {
                tensor(format!("{}.{end}", norm.name), &[values.len()], values);
            }
        }
    }

    /// Adds all tensors to a file under `prefix`.
    pub(super) fn store(&self, builder: &mut WeightsBuilder, prefix: &str, precision: Precision) {
        self.visit(|name, shape, values| {
            builder.values(&format!("{prefix}{name}"), shape, values, precision);
        });
    }

    /// Adds all tensors to a hash, as f32, so that the number format of the file does not matter.
    pub(super) fn hash(&self, hash: &mut Sha256) {
        self.visit(|name, shape, values| {
            hash_tensor_header(hash, &name, "F32", shape);
            for v in values {
                hash.update(v.to_le_bytes());
            }
        });
    }

    /// Rounds all weights to what `precision` can hold.
    pub(super) fn round(&mut self, precision: Precision) {
        let round = |values: &mut Vec<f32>| {
            for v in values {
                *v = precision.round(*v);
            }
        };
        let round_conv = |conv: &mut Conv| {
            conv.forget_packed();
            round(&mut conv.weight);
            conv.bias.iter_mut().for_each(round);
        };
        self.convs_mut().for_each(round_conv);
        for layer in &mut self.layers {
            if let Layer::Block(_, Some(branch)) = layer {
                round_conv(&mut branch.widen);
                round_conv(&mut branch.narrow);
                round(&mut branch.norm.affine.0);
                round(&mut branch.norm.affine.1);
            }
        }
    }
}

impl Branch {
    fn build(source: &mut impl Source, block: &str, width: usize) -> Result<Self> {
        let wide = width * BRANCH_FACTOR;
        let name = |i: usize| format!("{block}.pool.{i}");
        let mut conv = |name, inputs, outputs, gain| {
            let shape = ConvShape::same(inputs, outputs, 1);
            source.conv(name, (shape, false), false, gain)
        };
        let (widen, narrow) = (
            conv(name(0), width, wide, 1.0)?,
            conv(name(3), wide, width, 0.3)?,
        );
        let norm = name(1);
        Ok(Self {
            widen,
            narrow,
            norm: GroupNorm {
                affine: (
                    source.vector(&format!("{norm}.weight"), wide, 1.0)?,
                    source.vector(&format!("{norm}.bias"), wide, 0.0)?,
                ),
                name: norm,
                groups: BRANCH_GROUPS,
                eps: BRANCH_EPS,
            },
        })
    }
}
