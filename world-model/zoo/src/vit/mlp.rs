//! The feed-forward half of a block.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_model::ops::swiglu;

use crate::Engine;
use crate::Result;
use crate::layers::{Linear, gelu_exact, gelu_tanh};

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
    /// Applies it to every value.
    pub(crate) fn apply(self, engine: Engine, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::GeluExact => gelu_exact(engine, x),
            Self::GeluTanh => gelu_tanh(engine, x),
        }
    }
}

/// A feed-forward network.
#[derive(Clone, Debug)]
pub(crate) enum Mlp {
    /// Linear, activation, linear.
    Plain {
        first: Linear,
        activation: Activation,
        second: Linear,
    },
    /// Linear to twice the width, silu(first half) * second half, linear.
    SwiGlu {
        gate_and_value: Linear,
        out: Linear,
        engine: Engine,
    },
}

impl Mlp {
    /// (.., width) to (.., width).
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Plain {
                first,
                activation,
                second,
            } => second.forward(&activation.apply(first.engine(), &first.forward(x)?)?),
            Self::SwiGlu {
                gate_and_value,
                out,
                engine,
            } => out.forward(&swiglu(*engine, &gate_and_value.forward(x)?)?),
        }
    }
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
