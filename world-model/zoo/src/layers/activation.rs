//! Activation functions.

use candle_core::Tensor;

use crate::Result;

/// x times the normal distribution function of x: `torch.nn.GELU()`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub fn gelu_exact(x: &Tensor) -> Result<Tensor> {
    Ok(x.gelu_erf()?)
}

/// The approximation of [`gelu_exact`] with tanh: `torch.nn.GELU(approximate="tanh")`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub fn gelu_tanh(x: &Tensor) -> Result<Tensor> {
    Ok(x.gelu()?)
}

/// x times the logistic function of x.
///
/// # Errors
/// If the values are not floating-point numbers.
pub fn silu(x: &Tensor) -> Result<Tensor> {
    Ok(x.silu()?)
}
