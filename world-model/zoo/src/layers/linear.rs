//! y = x W^T + b.

use candle_core::{D, Tensor};

use super::takes_kernels;
use crate::{Engine, Result};

/// A matrix product with an optional bias.
#[derive(Clone, Debug)]
pub struct Linear {
    /// (outputs, inputs), contiguous.
    weight: Tensor,
    /// (outputs).
    bias: Option<Tensor>,
    engine: Engine,
}

impl Linear {
    /// `weight` is (outputs, inputs), `bias` (outputs).
    ///
    /// # Errors
    /// If the weight is no matrix, or the bias does not fit it.
    pub fn new(weight: Tensor, bias: Option<Tensor>, engine: Engine) -> Result<Self> {
        let (outputs, _) = weight.dims2()?;
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
        Ok(Self {
            weight,
            bias,
            engine,
        })
    }

    /// `x` (.., inputs) to (.., outputs).
    ///
    /// # Errors
    /// If `x` has another last dimension or number format.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        if takes_kernels(self.engine, x) {
            let weight = self.weight.contiguous()?;
            let bias = self.bias.as_ref().map(Tensor::contiguous).transpose()?;
            return Ok(wm_model::ops::linear(x, &weight, bias.as_ref())?);
        }
        let inputs = x.dim(D::Minus1)?;
        let mut dims = x.dims().to_vec();
        if let Some(last) = dims.last_mut() {
            *last = self.weight.dim(0)?;
        }
        // As one product of two matrices: candle would run a batch of small ones, copying the weight for each.
        let rows = x.reshape(((), inputs))?;
        let mut y = rows.matmul(&self.weight.t()?)?;
        if let Some(bias) = &self.bias {
            y = y.broadcast_add(bias)?;
        }
        Ok(y.reshape(dims)?)
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
                let linear = Linear::new(weight.clone(), bias.clone(), engine).unwrap();
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
        let error = Linear::new(zeros(&[3, 2]).unwrap(), Some(bias), Engine::Cpu).unwrap_err();
        assert!(error.to_string().contains("[4]"), "{error}");
    }
}
