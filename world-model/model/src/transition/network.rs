//! The layers of the transition model, whatever computes them.

use super::TransitionConfig;
use super::block::{Block, SubBlock};
use super::condition::ConditionEmbedding;
use super::head::Head;
use super::parameters::Initialisation;
use crate::Result;

/// All layers but the patch embedding, with the weights `W` of their linear layers.
#[derive(Clone, Debug)]
pub(super) struct Network<W> {
    pub(super) condition: ConditionEmbedding<W>,
    pub(super) blocks: Vec<Block<W>>,
    pub(super) head: Head<W>,
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

impl<W> Network<W> {
    /// The layers of a configuration, in the order of the forward pass.
    pub(super) fn new(
        config: &TransitionConfig,
        source: &mut impl LinearSource<Linear = W>,
    ) -> Result<Self> {
        let condition = ConditionEmbedding::new(config, source)?;
        let mut part = |name: String| SubBlock::new(&name, config, source);
        let blocks = (0..config.depth).map(|index| {
            let spatial = part(format!("blocks.{index}.s_block"))?;
            Ok([spatial, part(format!("blocks.{index}.t_block"))?])
        });
        Ok(Self {
            condition,
            blocks: blocks.collect::<Result<_>>()?,
            head: Head::new(config, source)?,
        })
    }
}
