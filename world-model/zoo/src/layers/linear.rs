//! y = x W^T + b.

use candle_core::{D, Tensor};
use wm_model::Kernels;
use wm_model::NumberFormat;
use wm_model::ops::{self, PackedLinear};

use super::{Activation, host, takes_kernels};
use crate::Result;

/// A matrix product with an optional bias.
#[derive(Clone, Debug)]
pub(crate) struct Linear {
    weights: Weights,
    outputs: usize,
    kernels: Kernels,
}

#[derive(Clone, Debug)]
enum Weights {
    /// For the kernels.
    Packed(PackedLinear),
    /// (outputs, inputs), and the bias (outputs).
    Plain(Tensor, Option<Tensor>),
}

impl Linear {
    /// `weight` is (outputs, inputs), `bias` (outputs). For the kernels they are packed in `format`.
    ///
    /// # Errors
    /// If the weight is no matrix, or the bias does not fit it.
    pub(crate) fn new(
        weight: Tensor,
        bias: Option<Tensor>,
        kernels: Kernels,
        format: NumberFormat,
    ) -> Result<Self> {
        let (outputs, inputs) = weight.dims2()?;
        if let Some(bias) = &bias
            && bias.dims() != [outputs]
        {
            return Err(wm_model::Error::Shape {
                what: "the bias of a Linear",
                expected: format!("({outputs})"),
                found: bias.dims().to_vec(),
            }
            .into());
        }
        // A skeleton's weights are one repeated zero, and stay so: it is for counting.
        let weights = if takes_kernels(kernels, &weight) && !host::is_repeated(&weight) {
            let bias: Option<Vec<f32>> = bias.map(|bias| bias.to_vec1()).transpose()?;
            let shape = (outputs, inputs);
            Weights::Packed(host::with_values(&weight, |weight| {
                PackedLinear::new(weight, bias.as_deref(), shape, format)
            })??)
        } else {
            Weights::Plain(weight, bias)
        };
        Ok(Self {
            weights,
            outputs,
            kernels,
        })
    }

    /// Of weights that are packed already.
    pub(crate) fn packed(packed: PackedLinear) -> Self {
        Self {
            outputs: packed.outputs(),
            weights: Weights::Packed(packed),
            kernels: Kernels::Cpu,
        }
    }

    /// What its weights are packed in for the kernels.
    pub(crate) fn format(&self) -> NumberFormat {
        match &self.weights {
            Weights::Packed(packed) => packed.format(),
            Weights::Plain(..) => NumberFormat::F32,
        }
    }

    /// `x` (.., inputs) to (.., outputs).
    ///
    /// # Errors
    /// If `x` has another last dimension, or for the kernels another number format than f32.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match &self.weights {
            Weights::Packed(packed) => self.on_kernel(packed, x, |_, _| {}),
            Weights::Plain(weight, bias) => {
                Ok(ops::linear(Kernels::Candle, x, weight, bias.as_ref())?)
            }
        }
    }

    /// `activation` of what [`Self::forward`] gives.
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub(crate) fn forward_activated(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        match &self.weights {
            Weights::Packed(packed) => {
                self.on_kernel(packed, x, |rows, _| activation.of_values(rows))
            }
            Weights::Plain(..) => activation.apply(self.kernels, &self.forward(x)?),
        }
    }

    /// `residual` (.., outputs) plus what [`Self::forward`] gives, of which each output is multiplied with its `scale`
    /// (outputs) first.
    ///
    /// # Errors
    /// As [`Self::forward`], or if `residual` or `scale` has another shape.
    pub(crate) fn forward_onto(
        &self,
        x: &Tensor,
        residual: &Tensor,
        scale: Option<&Tensor>,
    ) -> Result<Tensor> {
        let (Weights::Packed(packed), true) =
            (&self.weights, takes_kernels(self.kernels, residual))
        else {
            return add_scaled(residual, &self.forward(x)?, scale);
        };
        let mut dims = x.dims().to_vec();
        if let Some(last) = dims.last_mut() {
            *last = self.outputs;
        }
        if residual.dims() != dims {
            return Err(wm_model::Error::Shape {
                what: "what a Linear adds to",
                expected: format!("{dims:?}"),
                found: residual.dims().to_vec(),
            }
            .into());
        }
        let scale = match scale {
            Some(scale) => scale.to_vec1()?,
            None => vec![1.0; self.outputs],
        };
        host::with_values(residual, |residual| {
            self.on_kernel(packed, x, |rows, first| {
                let from = residual.get(first * self.outputs..);
                debug_assert!(from.is_some(), "the residual has the shape of the result");
                let from = from.unwrap_or_default();
                ops::scale_and_add_rows(rows, &scale, from);
            })
        })?
    }

    /// The product by the kernel, and `then` of every few rows.
    fn on_kernel(
        &self,
        packed: &PackedLinear,
        x: &Tensor,
        then: impl Fn(&mut [f32], usize) + Sync,
    ) -> Result<Tensor> {
        let inputs = x.dim(D::Minus1)?;
        let mut dims = x.dims().to_vec();
        if let Some(last) = dims.last_mut() {
            *last = self.outputs;
        }
        if inputs != packed.inputs() {
            return Err(wm_model::Error::Shape {
                what: "the input of a Linear",
                expected: format!("(.., {})", packed.inputs()),
                found: x.dims().to_vec(),
            }
            .into());
        }
        let y = host::with_values(x, |x| packed.product_on_pool_then(x, then))?;
        Ok(Tensor::from_vec(y, dims, x.device())?)
    }
}

/// `x` plus `update`, of which the last dimension is multiplied with `scale` first.
fn add_scaled(x: &Tensor, update: &Tensor, scale: Option<&Tensor>) -> Result<Tensor> {
    Ok(match scale {
        Some(scale) => (x + update.broadcast_mul(scale)?)?,
        None => (x + update)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::random::normal;

    #[test]
    fn both_engines_agree() {
        let random = |shape: &[usize], seed| normal(shape, seed).unwrap();
        let (weight, bias) = (random(&[7, 5], 1), random(&[7], 2));
        let x = random(&[2, 3, 4, 5], 3);
        for bias in [Some(bias), None] {
            let [a, b] = [Kernels::Candle, Kernels::Cpu].map(|kernels| {
                let linear =
                    Linear::new(weight.clone(), bias.clone(), kernels, NumberFormat::F32).unwrap();
                linear.forward(&x).unwrap()
            });
            assert_eq!(a.dims(), [2, 3, 4, 7]);
            let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
            assert!(difference.to_scalar::<f32>().unwrap() < 1e-5);
        }
    }

    #[test]
    fn what_follows_a_product_is_the_same_on_both_engines() {
        let random = |shape: &[usize], seed| normal(shape, seed).unwrap();
        let (weight, bias, x) = (random(&[7, 5], 1), random(&[7], 2), random(&[2, 3, 5], 3));
        let (residual, scale) = (random(&[2, 3, 7], 4), random(&[7], 5));
        let linear = |kernels| {
            Linear::new(
                weight.clone(),
                Some(bias.clone()),
                kernels,
                NumberFormat::F32,
            )
            .unwrap()
        };
        let (kernels, plain) = (linear(Kernels::Cpu), linear(Kernels::Candle));
        let close = |a: Tensor, b: Tensor| {
            let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
            assert!(difference.to_scalar::<f32>().unwrap() < 1e-5);
        };
        for activation in [Activation::GeluExact, Activation::GeluTanh] {
            let of = |linear: &Linear| linear.forward_activated(&x, activation).unwrap();
            close(of(&kernels), of(&plain));
        }
        for scale in [None, Some(&scale)] {
            let of = |linear: &Linear| linear.forward_onto(&x, &residual, scale).unwrap();
            close(of(&kernels), of(&plain));
        }
        let error = kernels.forward_onto(&x, &x, None).unwrap_err();
        assert!(error.to_string().contains("[2, 3, 7]"), "{error}");
    }

    #[test]
    fn a_bias_of_another_length_is_named() {
        let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu);
        let bias = zeros(&[4]).unwrap();
        let error = Linear::new(
            zeros(&[3, 2]).unwrap(),
            Some(bias),
            Kernels::Cpu,
            NumberFormat::F32,
        )
        .unwrap_err();
        assert!(error.to_string().contains("[4]"), "{error}");
    }
}
