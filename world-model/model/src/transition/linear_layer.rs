//! A linear layer of the transition model, and where its weights come from.

use crate::Result;

/// Values that training starts from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Initialisation {
    /// All zero.
    Zero,
    /// Uniform within sqrt(6 / (fan in + fan out)).
    Xavier,
    /// Normal with this standard deviation.
    Normal(f64),
}

/// A linear layer, before it has weights.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearLayer {
    /// (outputs, inputs).
    pub(super) shape: (usize, usize),
    pub(super) has_bias: bool,
    /// Whether its outputs act on every token of a frame, so that rounding its weights costs more than elsewhere.
    pub(super) is_sensitive: bool,
    /// Values that training starts from.
    pub(super) initialisation: Initialisation,
}

/// Makes the linear layers of a network.
pub(super) trait LinearSource {
    /// The weights of a linear layer.
    type Linear;

    /// The layer of a name.
    fn linear(&mut self, name: &str, layer: LinearLayer) -> Result<Self::Linear>;
}

impl LinearLayer {
    /// With a bias.
    pub(super) fn new(outputs: usize, inputs: usize, initialisation: Initialisation) -> Self {
        Self {
            shape: (outputs, inputs),
            has_bias: true,
            is_sensitive: false,
            initialisation,
        }
    }

    pub(super) fn without_bias(self) -> Self {
        Self {
            has_bias: false,
            ..self
        }
    }

    pub(super) fn sensitive(self) -> Self {
        Self {
            is_sensitive: true,
            ..self
        }
    }
}
