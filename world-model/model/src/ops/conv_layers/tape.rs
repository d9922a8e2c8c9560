//! Networks on kernels of the CPU, with their gradients.

use super::{Conv, ConvLayers, GroupNorm};
use crate::ops::buffer::Buffer;
use crate::ops::{GridSize, conv2d_input_gradient, conv2d_weight_gradient};
use crate::{Error, Result};

/// The record of a forward pass. Its memory serves later passes.
#[derive(Debug, Default)]
pub struct Tape {
    /// The input of the network, then the output of each convolution; the memory of earlier passes follows.
    values: Vec<(Vec<f32>, GridSize)>,
    steps: Vec<Step>,
}

/// A convolution in the record; values by their numbers.
#[derive(Debug)]
struct Step {
    input: usize,
    residual: Option<usize>,
}

/// Gradients by the weights of convolutions, in the order of the forward pass.
#[derive(Clone, Debug, Default)]
pub struct ConvGradients {
    /// For each convolution: by its weight, and by its bias (empty if it has none).
    pub convs: Vec<(Vec<f32>, Vec<f32>)>,
}

impl Tape {
    /// Forgets the record and begins another with the input of a network; gives the number of that value.
    pub(crate) fn begin(&mut self, input: &[f32], grid: GridSize) -> usize {
        self.steps.clear();
        let (values, size) = self.value_mut(0);
        *size = grid;
        values.clear();
        values.extend_from_slice(input);
        0
    }

    /// The value of a number.
    pub(crate) fn value(&self, number: usize) -> &[f32] {
        self.values
            .get(number)
            .map_or(&[], |(values, _)| values.as_slice())
    }

    fn value_mut(&mut self, number: usize) -> &mut (Vec<f32>, GridSize) {
        if self.values.len() <= number {
            let empty = GridSize {
                images: 0,
                height: 0,
                width: 0,
            };
            self.values.resize_with(number + 1, || (Vec::new(), empty));
        }
        &mut self.values[number]
    }

    /// Writes the gradients by the weights of `convs`, the convolutions of the record in its order, for a `gradient` by
    /// the last output. Writes the gradient by the input to `by_input`.
    ///
    /// # Errors
    /// If the record is of other convolutions, or `gradient` has another length than the last output.
    pub fn backward<'a>(
        &self,
        convs: impl Iterator<Item = &'a Conv>,
        gradient: &[f32],
        gradients: &mut ConvGradients,
        by_input: Option<&mut Vec<f32>>,
    ) -> Result<()> {
        let convs: Vec<&Conv> = convs.collect();
        let output = self.value(self.steps.len());
        if gradient.len() != output.len() || convs.len() != self.steps.len() {
            return Err(Error::Shape {
                what: "the gradient by the output, and the convolutions",
                expected: format!("[{}, {}]", output.len(), self.steps.len()),
                found: vec![gradient.len(), convs.len()],
            });
        }
        gradients.convs.resize_with(convs.len(), Default::default);
        let mut by_output = Buffer::copy_of(gradient);
        if convs.last().is_some_and(|conv| conv.relu) {
            for (g, y) in by_output.iter_mut().zip(output) {
                if *y <= 0.0 {
                    *g = 0.0;
                }
            }
        }
        let mut by_value: Vec<Option<Buffer>> = Vec::new();
        by_value.resize_with(convs.len(), || None);
        by_value.push(Some(by_output));
        let steps = convs.iter().zip(&self.steps).zip(&mut gradients.convs);
        for (i, ((conv, step), (by_weight, by_bias))) in steps.enumerate().rev() {
            let Some(gradient) = by_value[i + 1].take() else {
                continue;
            };
            let (input, grid) = &self.values[step.input];
            by_weight.resize(conv.weight.len(), 0.0);
            by_bias.resize(conv.bias.as_ref().map_or(0, Vec::len), 0.0);
            let bias = conv.bias.is_some().then_some(by_bias.as_mut_slice());
            conv2d_weight_gradient(&conv.shape, input, &gradient, *grid, by_weight, bias)?;
            let before = step.input.checked_sub(1).and_then(|i| convs.get(i));
            if before.is_some() || by_input.is_some() {
                // The ReLU that made the input is applied with each gradient by it; a residual's comes first, because
                // a value is the input of a convolution earlier than it is added.
                let earlier = by_value[step.input].take();
                let mask = before.is_some_and(|conv| conv.relu);
                let mut by_this = Buffer::of(input.len());
                conv2d_input_gradient(
                    &conv.shape,
                    &conv.weight,
                    &gradient,
                    *grid,
                    earlier.as_deref(),
                    mask.then_some(input),
                    &mut by_this,
                )?;
                by_value[step.input] = Some(by_this);
            }
            if let Some(residual) = step.residual {
                by_value[residual] = Some(gradient);
            }
        }
        if let Some(by_input) = by_input {
            by_input.clear();
            by_input.extend_from_slice(by_value[0].as_deref().unwrap_or_default());
        }
        Ok(())
    }
}

/// Values are numbers in the record.
impl ConvLayers for Tape {
    type Value = usize;

    fn conv(&mut self, conv: &Conv, x: &usize, residual: Option<&usize>) -> Result<usize> {
        let number = self.steps.len() + 1;
        // Out of the record, so that it can be written while inputs are read.
        let mut output = std::mem::take(&mut self.value_mut(number).0);
        let (input, grid) = &self.values[*x];
        let added = residual.map(|number| self.value(*number));
        let grid = conv.run(input, *grid, added, &mut output)?;
        self.values[number] = (output, grid);
        self.steps.push(Step {
            input: *x,
            residual: residual.copied(),
        });
        Ok(number)
    }

    fn group_norm_relu(&mut self, _: &GroupNorm, _: usize) -> Result<usize> {
        Err(Error::config(
            "branch",
            "true: only networks without the branch can be trained",
        ))
    }
}
