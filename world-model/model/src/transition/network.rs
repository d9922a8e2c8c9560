//! The layers of the transition model, whatever computes them.

use super::TransitionConfig;
use super::block::{Block, SubBlock};
use super::condition::ConditionEmbedding;
use super::head::Head;
use super::linear_layer::LinearSource;
use crate::Result;

/// All layers but the patch embedding, with the weights `W` of their linear layers.
#[derive(Clone, Debug)]
pub(super) struct Network<W> {
    pub(super) condition: ConditionEmbedding<W>,
    pub(super) blocks: Vec<Block<W>>,
    pub(super) head: Head<W>,
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
