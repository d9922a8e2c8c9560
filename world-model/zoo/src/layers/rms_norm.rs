//! Root-mean-square normalisation.

use candle_core::{D, DType, Tensor};

use crate::Result;

/// x / sqrt(mean(x^2) + eps) over the last dimension, without a learned scale. Computed in f32, given back in the
/// format of `x`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub(crate) fn rms_norm(x: &Tensor, eps: f64) -> Result<Tensor> {
    let wide = x.to_dtype(DType::F32)?;
    let mean_square = wide.sqr()?.mean_keepdim(D::Minus1)?;
    let normed = wide.broadcast_div(&(mean_square + eps)?.sqrt()?)?;
    Ok(normed.to_dtype(x.dtype())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn the_mean_square_becomes_one() {
        let x = Tensor::new(&[[3f32, -4.0], [0.0, 0.0]], &Device::Cpu).unwrap();
        let y = rms_norm(&x, 0.0).unwrap().to_vec2::<f32>().unwrap();
        let rms = 12.5f32.sqrt();
        assert!((y[0][0] - 3.0 / rms).abs() < 1e-6 && (y[0][1] + 4.0 / rms).abs() < 1e-6);
        let y = rms_norm(&x, 1e-6).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(y[1], [0.0, 0.0]);
    }
}
