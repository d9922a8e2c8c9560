//! The transformer blocks: attention within a frame, then attention over time.

use std::sync::Arc;

use candle_core::Tensor;

use super::embedding::Condition;
use super::parameters::{Linear, Tensors};
use crate::Result;
use crate::ops::{self, AttentionPattern, Engine, gated_residual, rms_norm_modulate, swiglu};

/// Order of a sub-block's modulation: shift, scale and gate of the attention, then of the
/// feed-forward network.
pub(super) const ATTENTION: [usize; 3] = [0, 1, 2];
pub(super) const FEED_FORWARD: [usize; 3] = [3, 4, 5];

/// A spatial and a temporal sub-block.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub(super) spatial: SubBlock,
    pub(super) temporal: SubBlock,
}

impl Block {
    pub(super) fn new(index: usize, tensors: &mut Tensors) -> Result<Self> {
        Ok(Self {
            spatial: SubBlock::new(&format!("blocks.{index}.s_block"), tensors)?,
            temporal: SubBlock::new(&format!("blocks.{index}.t_block"), tensors)?,
        })
    }

    /// Tokens (B, T, N, d).
    pub(super) fn forward(
        &self,
        engine: Engine,
        tokens: &Tensor,
        condition: &Condition,
        spatial: &Arc<AttentionPattern>,
        temporal: &Arc<AttentionPattern>,
    ) -> Result<Tensor> {
        let attend = |qkv: &Tensor| Ok(ops::attention(engine, qkv, spatial)?);
        let tokens = self.spatial.forward(engine, tokens, condition, attend)?;
        let attend = |qkv: &Tensor| Ok(ops::attention(engine, qkv, temporal)?);
        self.temporal.forward(engine, &tokens, condition, attend)
    }
}

#[derive(Clone, Debug)]
pub(super) struct SubBlock {
    pub(super) modulation: Linear,
    pub(super) qkv: Linear,
    pub(super) out: Linear,
    pub(super) up: Linear,
    pub(super) down: Linear,
}

impl SubBlock {
    fn new(name: &str, tensors: &mut Tensors) -> Result<Self> {
        Ok(Self {
            modulation: tensors.linear(&format!("{name}.adaLN_modulation.1"))?,
            qkv: tensors.linear_no_bias(&format!("{name}.attn.qkv_proj"))?,
            out: tensors.linear(&format!("{name}.attn.out_proj"))?,
            up: tensors.linear(&format!("{name}.ffwd.w12"))?,
            down: tensors.linear(&format!("{name}.ffwd.w3"))?,
        })
    }

    fn forward(
        &self,
        engine: Engine,
        x: &Tensor,
        condition: &Condition,
        attend: impl FnOnce(&Tensor) -> Result<Tensor>,
    ) -> Result<Tensor> {
        let modulation = self.modulation.forward(engine, &condition.activated)?;
        let [shift, scale, gate] = ATTENTION;
        let normed = rms_norm_modulate(engine, x, &modulation, shift, scale)?;
        let attended = self
            .out
            .forward(engine, &attend(&self.qkv.forward(engine, &normed)?)?)?;
        let x = gated_residual(engine, x, &attended, &modulation, gate)?;
        let [shift, scale, gate] = FEED_FORWARD;
        let normed = rms_norm_modulate(engine, &x, &modulation, shift, scale)?;
        let fed = swiglu(engine, &self.up.forward(engine, &normed)?)?;
        let fed = self.down.forward(engine, &fed)?;
        Ok(gated_residual(engine, &x, &fed, &modulation, gate)?)
    }
}
