//! Layer normalisation.

use candle_core::{D, DType, Tensor};
use wm_model::Kernels;
use wm_model::ops;

use super::{host, takes_kernels};
use crate::Result;

/// Mean 0 and variance 1 over the last dimension, then a learned scale and shift.
#[derive(Clone, Debug)]
pub(crate) struct LayerNorm {
    /// (width).
    scale: Tensor,
    /// (width).
    shift: Tensor,
    eps: f64,
    kernels: Kernels,
}

impl LayerNorm {
    /// `scale` and `shift` are (width); `eps` is added to the variance.
    pub(crate) fn new(scale: Tensor, shift: Tensor, eps: f64, kernels: Kernels) -> Self {
        Self {
            scale,
            shift,
            eps,
            kernels,
        }
    }

    /// `x` (.., width) to the same shape. Computed in f32, given back in the format of `x`.
    ///
    /// # Errors
    /// If `x` has another last dimension.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        if takes_kernels(self.kernels, x) && x.dim(D::Minus1)? == self.scale.dim(0)? {
            let (scale, shift) = (self.scale.to_vec1::<f32>()?, self.shift.to_vec1::<f32>()?);
            let normed =
                host::with_values(x, |x| ops::layer_norm(x, (&scale, &shift), self.eps as f32))?;
            return Ok(Tensor::from_vec(normed, x.shape(), x.device())?);
        }
        let wide = x.to_dtype(DType::F32)?;
        let centred = wide.broadcast_sub(&wide.mean_keepdim(D::Minus1)?)?;
        let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
        let normed = centred.broadcast_div(&(variance + self.eps)?.sqrt()?)?;
        let scaled = normed
            .broadcast_mul(&self.scale.to_dtype(DType::F32)?)?
            .broadcast_add(&self.shift.to_dtype(DType::F32)?)?;
        Ok(scaled.to_dtype(x.dtype())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn rows_get_mean_zero_and_variance_one_before_the_affine_map() {
        let x = Tensor::new(&[[1f32, 2.0, 3.0, 6.0]], &Device::Cpu).unwrap();
        let scale = Tensor::new(&[1f32, 1.0, 1.0, 2.0], &Device::Cpu).unwrap();
        let shift = Tensor::new(&[0f32, 0.0, 5.0, 0.0], &Device::Cpu).unwrap();
        for kernels in [Kernels::Candle, Kernels::Cpu] {
            let norm = LayerNorm::new(scale.clone(), shift.clone(), 0.0, kernels);
            let y = norm.forward(&x).unwrap().to_vec2::<f32>().unwrap();
            let deviation = 3.5f32.sqrt();
            for (found, expected) in y[0].iter().zip([-2.0, -1.0, 0.0, 6.0]) {
                let expected = expected / deviation + if expected == 0.0 { 5.0 } else { 0.0 };
                assert!((found - expected).abs() < 1e-6, "{found} {expected}");
            }
        }
    }
}
