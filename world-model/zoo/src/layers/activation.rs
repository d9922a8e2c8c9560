//! Activation functions.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_model::Kernels;
use wm_model::ops;

use super::{host, takes_kernels};
use crate::Result;

/// Activation function, by the names that Hugging Face configurations use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activation {
    /// x times the normal distribution function of x.
    #[default]
    #[serde(rename = "gelu")]
    GeluExact,
    /// The approximation of it with tanh.
    #[serde(rename = "gelu_pytorch_tanh", alias = "gelu_new")]
    GeluTanh,
}

impl Activation {
    /// Applies it to every value of `values`.
    pub(crate) fn of_values(self, values: &mut [f32]) {
        match self {
            Self::GeluExact => ops::gelu_exact(values),
            Self::GeluTanh => ops::gelu_tanh(values),
        }
    }

    /// Applies it to every value.
    pub(crate) fn apply(self, kernels: Kernels, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::GeluExact => gelu_exact(kernels, x),
            Self::GeluTanh => gelu_tanh(kernels, x),
        }
    }
}

/// x times the normal distribution function of x: `torch.nn.GELU()`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub(crate) fn gelu_exact(kernels: Kernels, x: &Tensor) -> Result<Tensor> {
    if takes_kernels(kernels, x) {
        return host::changed(x, ops::gelu_exact);
    }
    Ok(x.gelu_erf()?)
}

/// The approximation of [`gelu_exact`] with tanh: `torch.nn.GELU(approximate="tanh")`.
///
/// # Errors
/// If the values are not floating-point numbers.
pub(crate) fn gelu_tanh(kernels: Kernels, x: &Tensor) -> Result<Tensor> {
    if takes_kernels(kernels, x) {
        return host::changed(x, ops::gelu_tanh);
    }
    Ok(x.gelu()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_hugging_face() {
        let parse = |name: &str| serde_json::from_str::<Activation>(name);
        assert_eq!(parse("\"gelu\"").unwrap(), Activation::GeluExact);
        let tanh = parse("\"gelu_pytorch_tanh\"").unwrap();
        assert_eq!(tanh, Activation::GeluTanh);
        assert!(parse("\"relu\"").unwrap_err().to_string().contains("relu"));
    }
}
