//! Activation functions.

use candle_core::Tensor;
use wm_model::ops;

use super::{host, takes_kernels};
use crate::{Engine, Result};

/// x times the normal distribution function of x: `torch.nn.GELU()`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub fn gelu_exact(engine: Engine, x: &Tensor) -> Result<Tensor> {
    if takes_kernels(engine, x) {
        return host::changed(x, ops::gelu_exact);
    }
    Ok(x.gelu_erf()?)
}

/// The approximation of [`gelu_exact`] with tanh: `torch.nn.GELU(approximate="tanh")`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub fn gelu_tanh(engine: Engine, x: &Tensor) -> Result<Tensor> {
    if takes_kernels(engine, x) {
        return host::changed(x, ops::gelu_tanh);
    }
    Ok(x.gelu()?)
}

/// x times the logistic function of x.
///
/// # Errors
/// If the values are not floating-point numbers.
pub fn silu(engine: Engine, x: &Tensor) -> Result<Tensor> {
    if takes_kernels(engine, x) {
        return host::changed(x, ops::silu);
    }
    Ok(x.silu()?)
}
