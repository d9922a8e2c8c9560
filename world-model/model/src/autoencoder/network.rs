//! One half of an autoencoder: a chain of convolutions and residual blocks.

mod tensors;

use std::sync::OnceLock;

use rand::Rng;
use sha2::{Digest, Sha256};

use crate::ops::{Activation, ConvShape, Fused, GridSize, PackedConv, PackedFormat, group_norm};
use crate::weights::{Precision, WeightsBuilder, hash_tensor_header};
use crate::{Result, Weights};
pub(super) use tensors::TensorNetwork;

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

/// A convolution with its weights.
#[derive(Clone, Debug)]
pub struct Conv {
    /// Name of its tensors without `.weight` and `.bias`.
    pub name: String,
    /// What it does.
    pub shape: ConvShape,
    /// Whether a ReLU follows.
    pub relu: bool,
    /// Whether it is the first of a residual block, and the block's input is added two convolutions
    /// later.
    pub opens_block: bool,
    /// Weights: kernel row, kernel column, input channel, output channel.
    pub weight: Vec<f32>,
    /// Bias, if it has one.
    pub bias: Option<Vec<f32>>,
    /// Made when it is first run.
    packed: OnceLock<PackedConv>,
}

/// The branch of a residual block.
#[derive(Clone, Debug)]
struct Branch {
    name: String,
    widen: Conv,
    scale: Vec<f32>,
    shift: Vec<f32>,
    narrow: Conv,
}

#[derive(Clone, Debug)]
enum Layer {
    /// Index into the convolutions.
    Conv(usize),
    /// Index of the first of three convolutions.
    Block(usize, Option<Box<Branch>>),
}

/// Half an autoencoder.
#[derive(Clone, Debug)]
pub struct Network {
    convs: Vec<Conv>,
    layers: Vec<Layer>,
}

/// Where weights come from.
trait Source {
    /// A convolution's weight in the order of [`ConvShape`].
    fn weight(&mut self, name: &str, shape: &ConvShape, gain: f32) -> Result<Vec<f32>>;
    /// A vector that starts as `start`.
    fn vector(&mut self, name: &str, length: usize, start: f32) -> Result<Vec<f32>>;
}

struct Stored<'a> {
    weights: &'a Weights,
    prefix: &'a str,
}

impl Source for Stored<'_> {
    fn weight(&mut self, name: &str, shape: &ConvShape, _: f32) -> Result<Vec<f32>> {
        let ConvShape {
            inputs,
            outputs,
            kernel,
            ..
        } = *shape;
        let name = format!("{}{name}", self.prefix);
        let stored = self
            .weights
            .values(&name, &[outputs, inputs, kernel, kernel])?;
        Ok(transpose(&stored, outputs, inputs * kernel * kernel)
            .chunks_exact((kernel * kernel * outputs).max(1))
            .fold(vec![0.0; stored.len()], {
                // Now (input, tap, output); wanted is (tap, input, output).
                let mut input = 0;
                move |mut weight, taps| {
                    for (tap, row) in taps.chunks_exact(outputs).enumerate() {
                        let at = (tap * inputs + input) * outputs;
                        if let Some(target) = weight.get_mut(at..at + outputs) {
                            target.copy_from_slice(row);
                        }
                    }
                    input += 1;
                    weight
                }
            }))
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

fn transpose(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let mut out = vec![0.0; matrix.len()];
    for (r, row) in matrix.chunks_exact(columns.max(1)).enumerate() {
        for (v, target) in row.iter().zip(out.iter_mut().skip(r).step_by(rows.max(1))) {
            *target = *v;
        }
    }
    out
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
        let mut convs = Vec::new();
        let mut layers = Vec::new();
        for stage in stages {
            match stage {
                Stage::Conv {
                    name,
                    shape,
                    bias,
                    relu,
                } => {
                    layers.push(Layer::Conv(convs.len()));
                    // Without a ReLU behind it, half the variance keeps the level.
                    let gain = if *relu { 1.0 } else { 0.7 };
                    convs.push(conv(source, name.clone(), *shape, (*bias, *relu), gain)?);
                }
                Stage::Block {
                    name,
                    width,
                    branch,
                } => {
                    let first = convs.len();
                    let shape = ConvShape::same(*width, *width, 3);
                    for i in 0..3 {
                        let name = format!("{name}.conv.{}", 2 * i);
                        // A small last convolution lets a deep chain start near the identity.
                        let gain = if i == 2 { 0.3 } else { 1.0 };
                        let mut conv = conv(source, name, shape, (true, true), gain)?;
                        conv.opens_block = i == 0;
                        convs.push(conv);
                    }
                    let branch = if *branch {
                        Some(Box::new(Branch::build(source, name, *width)?))
                    } else {
                        None
                    };
                    layers.push(Layer::Block(first, branch));
                }
            }
        }
        Ok(Self { convs, layers })
    }

    /// The convolutions in order, without those of branches.
    pub fn convs(&self) -> &[Conv] {
        &self.convs
    }

    /// The convolutions in order, to change their weights.
    pub fn convs_mut(&mut self) -> &mut [Conv] {
        for conv in &mut self.convs {
            conv.packed.take();
        }
        &mut self.convs
    }

    /// Whether a block has a branch.
    pub fn has_branch(&self) -> bool {
        self.layers
            .iter()
            .any(|layer| matches!(layer, Layer::Block(_, Some(_))))
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        let count = |conv: &Conv| conv.weight.len() + conv.bias.as_ref().map_or(0, Vec::len);
        let branches: usize = self
            .branches()
            .map(|b| count(&b.widen) + count(&b.narrow) + b.scale.len() + b.shift.len())
            .sum();
        self.convs.iter().map(count).sum::<usize>() + branches
    }

    /// Floating-point operations of the convolutions for an input of size `grid`.
    pub fn flops(&self, mut grid: GridSize) -> usize {
        let mut total = 0;
        for conv in &self.convs {
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

    /// Runs the network on `input` (grid, channels); gives the output and its size.
    pub(super) fn forward(&self, input: Vec<f32>, grid: GridSize) -> Result<(Vec<f32>, GridSize)> {
        let mut x = input;
        let mut grid = grid;
        let mut next = Vec::new();
        let mut scratch = Vec::new();
        for layer in &self.layers {
            match layer {
                Layer::Conv(at) => {
                    for conv in self.convs.get(*at..=*at).unwrap_or_default() {
                        grid = conv.run(&x, grid, None, &mut next)?;
                        std::mem::swap(&mut x, &mut next);
                    }
                }
                Layer::Block(first, branch) => {
                    if let Some(branch) = branch {
                        branch.add_to(&mut x, grid)?;
                    }
                    if let Some([a, b, c]) = self.convs.get(*first..*first + 3) {
                        a.run(&x, grid, None, &mut next)?;
                        b.run(&next, grid, None, &mut scratch)?;
                        c.run(&scratch, grid, Some(&x), &mut next)?;
                    }
                    std::mem::swap(&mut x, &mut next);
                }
            }
        }
        Ok((x, grid))
    }

    /// Every tensor by name, with the shape and in the order of the published files.
    fn visit(&self, mut tensor: impl FnMut(String, Vec<usize>, Vec<f32>)) {
        let mut conv = |conv: &Conv| {
            let ConvShape {
                inputs,
                outputs,
                kernel,
                ..
            } = conv.shape;
            let taps = kernel * kernel;
            // (tap, input, output) to (output, tap, input) to (output, input, tap).
            let stored = transpose(&conv.weight, taps * inputs, outputs)
                .chunks_exact(taps * inputs)
                .flat_map(|filter| transpose(filter, taps, inputs))
                .collect();
            let shape = vec![outputs, inputs, kernel, kernel];
            tensor(format!("{}.weight", conv.name), shape, stored);
            if let Some(bias) = &conv.bias {
                tensor(
                    format!("{}.bias", conv.name),
                    vec![bias.len()],
                    bias.clone(),
                );
            }
        };
        self.convs.iter().for_each(&mut conv);
        for branch in self.branches() {
            conv(&branch.widen);
            conv(&branch.narrow);
        }
        for branch in self.branches() {
            for (end, values) in [("weight", &branch.scale), ("bias", &branch.shift)] {
                let name = format!("{}.pool.1.{end}", branch.name);
                tensor(name, vec![values.len()], values.clone());
            }
        }
    }

    /// Adds all tensors to a file under `prefix`.
    pub(super) fn store(&self, builder: &mut WeightsBuilder, prefix: &str, precision: Precision) {
        self.visit(|name, shape, values| {
            builder.values(&format!("{prefix}{name}"), &shape, &values, precision);
        });
    }

    /// Adds all tensors to a hash, as f32, so that the number format of the file does not matter.
    pub(super) fn hash(&self, hash: &mut Sha256) {
        self.visit(|name, shape, values| {
            hash_tensor_header(hash, &name, "F32", &shape);
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
        for conv in self.convs_mut() {
            round(&mut conv.weight);
            conv.bias.iter_mut().for_each(round);
        }
        for layer in &mut self.layers {
            if let Layer::Block(_, Some(branch)) = layer {
                branch.widen.packed.take();
                branch.narrow.packed.take();
                round(&mut branch.widen.weight);
                round(&mut branch.narrow.weight);
                round(&mut branch.scale);
                round(&mut branch.shift);
            }
        }
    }
}

fn conv(
    source: &mut impl Source,
    name: String,
    shape: ConvShape,
    (bias, relu): (bool, bool),
    gain: f32,
) -> Result<Conv> {
    let weight = source.weight(&format!("{name}.weight"), &shape, gain)?;
    let bias = bias
        .then(|| source.vector(&format!("{name}.bias"), shape.outputs, 0.0))
        .transpose()?;
    Ok(Conv {
        name,
        shape,
        relu,
        opens_block: false,
        weight,
        bias,
        packed: OnceLock::new(),
    })
}

impl Conv {
    /// Runs the convolution; `residual` is added before the ReLU.
    pub(super) fn run(
        &self,
        input: &[f32],
        grid: GridSize,
        residual: Option<&[f32]>,
        output: &mut Vec<f32>,
    ) -> Result<GridSize> {
        let fused = Fused {
            residual,
            relu: self.relu,
            ..Fused::default()
        };
        let packed = match self.packed.get() {
            Some(packed) => packed,
            None => {
                let packed = PackedConv::for_inference(
                    &self.shape,
                    &self.weight,
                    self.bias.as_deref(),
                    PackedFormat::F32,
                )?;
                self.packed.get_or_init(|| packed)
            }
        };
        packed.run(input, grid, fused, output)
    }
}

impl Branch {
    fn build(source: &mut impl Source, block: &str, width: usize) -> Result<Self> {
        let wide = width * BRANCH_FACTOR;
        let name = |i: usize| format!("{block}.pool.{i}");
        Ok(Self {
            name: block.to_owned(),
            widen: conv(
                source,
                name(0),
                ConvShape::same(width, wide, 1),
                (false, false),
                1.0,
            )?,
            scale: source.vector(&format!("{}.weight", name(1)), wide, 1.0)?,
            shift: source.vector(&format!("{}.bias", name(1)), wide, 0.0)?,
            narrow: conv(
                source,
                name(3),
                ConvShape::same(wide, width, 1),
                (false, false),
                0.3,
            )?,
        })
    }

    fn add_to(&self, x: &mut Vec<f32>, grid: GridSize) -> Result<()> {
        let mut wide = Vec::new();
        self.widen.run(x, grid, None, &mut wide)?;
        let affine = (self.scale.as_slice(), self.shift.as_slice());
        let pixels = grid.height * grid.width;
        group_norm(
            &mut wide,
            pixels,
            BRANCH_GROUPS,
            affine,
            BRANCH_EPS,
            Activation::Relu,
        );
        let mut sum = Vec::new();
        self.narrow.run(&wide, grid, Some(x), &mut sum)?;
        *x = sum;
        Ok(())
    }
}
