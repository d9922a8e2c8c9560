//! A linear layer of tensors.

use candle_core::{Result, Tensor};

use super::WeightGradients;
use crate::ops::buffer::Buffer;
use crate::ops::host::host;
use crate::ops::linear;

/// y = x W^T + b, of tensors.
#[derive(Clone, Debug)]
pub(crate) struct Linear {
    /// (outputs, inputs).
    pub(crate) weight: Tensor,
    /// (outputs).
    pub(crate) bias: Option<Tensor>,
}

/// For the tape: on kernels of the CPU.
impl Linear {
    /// (outputs, inputs).
    pub(super) fn sizes(&self) -> Result<(usize, usize)> {
        self.weight.dims2()
    }

    /// The product of rows `x` without the bias.
    pub(super) fn product(&self, x: &[f32]) -> Result<Buffer> {
        let (outputs, inputs) = self.sizes()?;
        let weight = host(&self.weight);
        let mut y = Buffer::of(x.len() / inputs * outputs);
        linear::forward(x, (outputs, inputs), weight.values()?, None, &mut y)?;
        Ok(y)
    }

    /// The bias, zeros if there is none.
    pub(super) fn bias(&self) -> Result<Buffer> {
        Ok(match &self.bias {
            Some(bias) => Buffer::copy_of(host(bias).values()?),
            None => Buffer::zeros(self.sizes()?.0),
        })
    }

    /// The gradient by rows `x`, for the gradient `g` by the result; those by the weights go to `gradients`.
    pub(super) fn back(&self, x: &[f32], g: &[f32], gradients: &WeightGradients) -> Result<Buffer> {
        let (outputs, inputs) = self.sizes()?;
        let weight = host(&self.weight);
        let mut grad_x = Buffer::of(x.len());
        linear::input_gradient(g, (outputs, inputs), weight.values()?, &mut grad_x)?;
        let mut grad_weight = vec![0.0; outputs * inputs];
        linear::weight_gradient(g, (outputs, inputs), x, &mut grad_weight)?;
        gradients.add(&self.weight, grad_weight);
        if let Some(bias) = &self.bias {
            let mut sums = vec![0.0; outputs];
            linear::sum_rows(g, &mut sums);
            gradients.add(bias, sums);
        }
        Ok(grad_x)
    }
}
