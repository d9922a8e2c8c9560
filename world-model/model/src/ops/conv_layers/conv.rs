//! A convolution with its weights.

use std::sync::OnceLock;

use crate::NumberFormat;
use crate::Result;
use crate::ops::{ConvShape, Fused, GridSize, PackedConv};

/// A convolution with its weights.
#[derive(Clone, Debug)]
pub struct Conv {
    /// Name of its tensors without `.weight` and `.bias`.
    pub name: String,
    /// Sizes and stride.
    pub shape: ConvShape,
    /// Whether a ReLU follows.
    pub relu: bool,
    /// Weights: kernel row, kernel column, input channel, output channel.
    pub weight: Vec<f32>,
    /// Bias of each output channel.
    pub bias: Option<Vec<f32>>,
    /// Made at the first run.
    packed: OnceLock<PackedConv>,
}

impl Conv {
    pub(crate) fn new(
        name: String,
        (shape, relu): (ConvShape, bool),
        weight: Vec<f32>,
        bias: Option<Vec<f32>>,
    ) -> Self {
        Self {
            name,
            shape,
            relu,
            weight,
            bias,
            packed: OnceLock::new(),
        }
    }

    /// Must be called before the weights change.
    pub(crate) fn forget_packed(&mut self) -> &mut Self {
        self.packed.take();
        self
    }

    /// The weights of a checkpoint (output, input, row, column) in the order of [`Conv::weight`].
    pub(crate) fn from_checkpoint(shape: &ConvShape, stored: &[f32]) -> Vec<f32> {
        let (taps, inputs) = (shape.kernel * shape.kernel, shape.inputs);
        let filters = transpose(stored, shape.outputs, inputs * taps);
        // (input, tap, output) to (tap, input, output).
        let mut weight = vec![0.0; filters.len()];
        for (i, row) in filters.chunks_exact(shape.outputs.max(1)).enumerate() {
            let at = (i % taps * inputs + i / taps) * shape.outputs;
            weight[at..at + shape.outputs].copy_from_slice(row);
        }
        weight
    }

    /// The weights in the order of checkpoints, and their shape: output, input, row, column.
    pub(crate) fn to_checkpoint(&self) -> ([usize; 4], Vec<f32>) {
        let ConvShape {
            inputs,
            outputs,
            kernel,
            ..
        } = self.shape;
        let taps = kernel * kernel;
        // (tap, input, output) to (output, tap, input) to (output, input, tap).
        let stored = transpose(&self.weight, taps * inputs, outputs)
            .chunks_exact(taps * inputs)
            .flat_map(|filter| transpose(filter, taps, inputs))
            .collect();
        ([outputs, inputs, kernel, kernel], stored)
    }

    /// Writes the convolution of `input`, plus `residual`, then the ReLU if it has one, to `output`; gives its size.
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
                let bias = self.bias.as_deref();
                let format = NumberFormat::F32;
                let packed = PackedConv::for_inference(&self.shape, &self.weight, bias, format)?;
                self.packed.get_or_init(|| packed)
            }
        };
        packed.run(input, grid, fused, output)
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
