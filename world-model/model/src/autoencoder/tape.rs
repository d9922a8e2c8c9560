//! Gradients of a network by its weights and its input.

use super::network::Network;
use crate::ops::{GridSize, conv2d_input_gradient, conv2d_weight_gradient};
use crate::{Error, Result};

/// What a training pass keeps: every activation, and buffers that later passes use again.
#[derive(Debug, Default)]
pub struct Tape {
    input: Vec<f32>,
    /// Size of each convolution's input.
    grids: Vec<GridSize>,
    /// Output of each convolution.
    outputs: Vec<Vec<f32>>,
    buffers: [Vec<f32>; 3],
}

/// Gradients of a network's convolutions, in order.
#[derive(Clone, Debug, Default)]
pub struct NetworkGradient {
    /// For each convolution: by its weight, and by its bias (empty if it has none).
    pub convs: Vec<(Vec<f32>, Vec<f32>)>,
}

impl Tape {
    /// Runs `network` on `input` (grid, channels) and keeps what [`Tape::backward`] needs; gives the
    /// output.
    ///
    /// # Errors
    /// If the network has a branch, which cannot be trained, or the input does not fit it.
    pub fn forward(&mut self, network: &Network, input: &[f32], grid: GridSize) -> Result<&[f32]> {
        if network.has_branch() {
            return Err(Error::config(
                "branch",
                "true: only networks without the branch can be trained",
            ));
        }
        let convs = network.convs();
        self.outputs.resize_with(convs.len(), Vec::new);
        self.input.clear();
        self.input.extend_from_slice(input);
        self.grids.clear();
        let mut grid = grid;
        let mut block_input = 0;
        for (i, conv) in convs.iter().enumerate() {
            self.grids.push(grid);
            if conv.opens_block {
                block_input = i;
            }
            let (done, rest) = self.outputs.split_at_mut(i);
            let before = |i: usize| match i.checked_sub(1) {
                None => self.input.as_slice(),
                Some(i) => done.get(i).map_or(&[][..], Vec::as_slice),
            };
            let residual = closes_block(network, i).then(|| before(block_input));
            if let Some(output) = rest.first_mut() {
                grid = conv.run(before(i), grid, residual, output)?;
            }
        }
        Ok(self.outputs.last().map_or(&[], Vec::as_slice))
    }

    /// Writes the gradients by all weights for a `gradient` by the last output, and, if
    /// `by_input` is there, the gradient by the input.
    ///
    /// # Errors
    /// If no forward pass of `network` came before, or `gradient` does not fit.
    pub fn backward(
        &mut self,
        network: &Network,
        gradient: &[f32],
        gradients: &mut NetworkGradient,
        by_input: Option<&mut Vec<f32>>,
    ) -> Result<()> {
        let convs = network.convs();
        let expected = self.outputs.last().map_or(0, Vec::len);
        if gradient.len() != expected {
            return Err(Error::Shape {
                what: "the gradient by the output",
                expected: format!("[{expected}]"),
                found: vec![gradient.len()],
            });
        }
        gradients.convs.resize_with(convs.len(), Default::default);
        let [current, next, skip] = &mut self.buffers;
        front(current, gradient.len()).copy_from_slice(gradient);
        if convs.last().is_some_and(|conv| conv.relu) {
            let output = self.outputs.last().map_or(&[][..], Vec::as_slice);
            let current = front(current, gradient.len());
            for (g, y) in current.iter_mut().zip(output) {
                if *y <= 0.0 {
                    *g = 0.0;
                }
            }
        }
        let wants_input = by_input.is_some();
        let steps = convs.iter().zip(&mut gradients.convs).zip(&self.grids);
        for (i, ((conv, (by_weight, by_bias)), &grid)) in steps.enumerate().rev() {
            let length = conv.shape.output(grid).pixels() * conv.shape.outputs;
            let gradient = if closes_block(network, i) {
                // Kept until the block's input gets it too.
                std::mem::swap(current, skip);
                skip.get(..length)
            } else {
                current.get(..length)
            };
            let gradient = gradient.unwrap_or_default();
            let before = i.checked_sub(1);
            let input = match before {
                None => &self.input,
                Some(i) => self.outputs.get(i).unwrap_or(&self.input),
            };
            by_weight.resize(conv.weight.len(), 0.0);
            by_bias.resize(conv.bias.as_ref().map_or(0, Vec::len), 0.0);
            let bias = conv.bias.is_some().then_some(by_bias.as_mut_slice());
            conv2d_weight_gradient(&conv.shape, input, gradient, grid, by_weight, bias)?;
            if before.is_none() && !wants_input {
                break;
            }
            let relu_before = before
                .and_then(|i| convs.get(i))
                .is_some_and(|conv| conv.relu);
            let length = grid.pixels() * conv.shape.inputs;
            let residual = match conv.opens_block {
                true => skip.get(..length),
                false => None,
            };
            conv2d_input_gradient(
                &conv.shape,
                &conv.weight,
                gradient,
                grid,
                residual,
                relu_before.then_some(input.as_slice()),
                front(next, length),
            )?;
            std::mem::swap(current, next);
        }
        if let Some(by_input) = by_input {
            by_input.clear();
            by_input.extend_from_slice(front(current, self.input.len()));
        }
        Ok(())
    }
}

/// The first `length` values of a buffer that never gets shorter: what is added to it is filled with zeros first.
fn front(buffer: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
    buffer.get_mut(..length).unwrap_or_default()
}

/// Whether convolution `i` is the last of a block.
fn closes_block(network: &Network, i: usize) -> bool {
    i.checked_sub(2)
        .and_then(|first| network.convs().get(first))
        .is_some_and(|conv| conv.opens_block)
}
