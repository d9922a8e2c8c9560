//! y = x W^T + b.

use candle_core::{D, Tensor};
use wm_model::ops::{self, PackedFormat, PackedLinear};

use super::{host, takes_kernels};
use crate::{Engine, Result};

/// A matrix product with an optional bias.
#[derive(Clone, Debug)]
pub struct Linear {
    weights: Weights,
    outputs: usize,
    engine: Engine,
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
    pub fn new(
        weight: Tensor,
        bias: Option<Tensor>,
        engine: Engine,
        format: PackedFormat,
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
        let weights = if takes_kernels(engine, &weight) && !host::is_repeated(&weight) {
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
            engine,
        })
    }

    /// Of weights that are packed already.
    pub(crate) fn packed(packed: PackedLinear) -> Self {
        Self {
            outputs: packed.outputs(),
            weights: Weights::Packed(packed),
            engine: Engine::Cpu,
        }
    }

    /// What computes it.
    pub(crate) fn engine(&self) -> Engine {
        self.engine
    }

    /// `x` (.., inputs) to (.., outputs).
    ///
    /// # Errors
    /// If `x` has another last dimension, or for the kernels another number format than f32.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match &self.weights {
            Weights::Packed(packed) => {
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
                let y = host::with_values(x, |x| {
                    let mut y = vec![0.0; x.len() / inputs.max(1) * self.outputs];
                    packed.forward_on_pool(x, &mut y);
                    y
                })?;
                Ok(Tensor::from_vec(y, dims, x.device())?)
            }
            Weights::Plain(weight, bias) => {
                Ok(ops::linear(Engine::Candle, x, weight, bias.as_ref())?)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn both_engines_agree() {
        let random = |shape: &[usize]| Tensor::randn(0f32, 1.0, shape, &Device::Cpu).unwrap();
        let (weight, bias) = (random(&[7, 5]), random(&[7]));
        let x = random(&[2, 3, 4, 5]);
        for bias in [Some(bias), None] {
            let [a, b] = [Engine::Candle, Engine::Cpu].map(|engine| {
                let linear =
                    Linear::new(weight.clone(), bias.clone(), engine, PackedFormat::F32).unwrap();
                linear.forward(&x).unwrap()
            });
            assert_eq!(a.dims(), [2, 3, 4, 7]);
            let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
            assert!(difference.to_scalar::<f32>().unwrap() < 1e-5);
        }
    }

    #[test]
    fn a_bias_of_another_length_is_named() {
        let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu);
        let bias = zeros(&[4]).unwrap();
        let error = Linear::new(
            zeros(&[3, 2]).unwrap(),
            Some(bias),
            Engine::Cpu,
            PackedFormat::F32,
        )
        .unwrap_err();
        assert!(error.to_string().contains("[4]"), "{error}");
    }
}
