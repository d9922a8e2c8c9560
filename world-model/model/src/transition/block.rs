//! The transformer blocks: attention within a frame, then attention over time.

use std::sync::Arc;

use super::TransitionConfig;
use super::linear_layer::Initialisation::{Xavier, Zero};
use super::linear_layer::{LinearLayer, LinearSource};
use crate::Result;
use crate::ops::AttentionPattern;
use crate::ops::token_layers::{ClipLayers, TokenLayers};

/// Chunks of a sub-block's modulation, of each half: shift, which scale follows, and gate.
const ATTENTION: (usize, usize) = (0, 2);
const FEED_FORWARD: (usize, usize) = (3, 5);

/// A spatial and a temporal sub-block.
pub(super) type Block<W> = [SubBlock<W>; 2];

/// Attention and a feed-forward network, modulated by the frames' noise levels and actions.
#[derive(Clone, Debug)]
pub(super) struct SubBlock<W> {
    pub(super) modulation: W,
    qkv: W,
    out: W,
    up: W,
    down: W,
}

/// The tokens of the last `last` frames after all `blocks`, for frames whose modulations start from `activated`. The
/// patterns are those of attention within a frame and over time.
pub(super) fn run_clips<L: ClipLayers>(
    blocks: &[Block<L::Linear>],
    layers: &mut L,
    mut x: L::Value,
    activated: &L::Value,
    patterns: [&Arc<AttentionPattern>; 2],
    last: usize,
) -> Result<L::Value> {
    let parts = blocks.iter().flat_map(|block| block.iter().zip(patterns));
    for (number, (part, pattern)) in parts.enumerate() {
        let mut modulation = layers.linear(&part.modulation, activated)?;
        let qkv = part.project(layers, &x, &modulation)?;
        let mut attended = layers.attention(&qkv, pattern)?;
        if number + 1 == 2 * blocks.len() {
            // After the last attention, no frame needs another one.
            x = layers.last_frames(x, last)?;
            attended = layers.last_frames(attended, last)?;
            modulation = layers.last_frames(modulation, last)?;
        }
        x = part.finish(layers, x, &attended, &modulation)?;
    }
    Ok(x)
}

impl<W> SubBlock<W> {
    pub(super) fn new(
        name: &str,
        config: &TransitionConfig,
        source: &mut impl LinearSource<Linear = W>,
    ) -> Result<Self> {
        let (d, h) = (config.hidden, config.ffn_hidden());
        let layer = LinearLayer::new;
        let mut linear = |part: &str, layer| source.linear(&format!("{name}.{part}"), layer);
        Ok(Self {
            modulation: linear("adaLN_modulation.1", layer(6 * d, d, Zero).sensitive())?,
            qkv: linear("attn.qkv_proj", layer(3 * d, d, Xavier).without_bias())?,
            out: linear("attn.out_proj", layer(d, d, Xavier))?,
            up: linear("ffwd.w12", layer(2 * h, d, Xavier))?,
            down: linear("ffwd.w3", layer(d, h, Xavier))?,
        })
    }

    /// Queries, keys and values of the tokens `x`.
    pub(super) fn project<L: TokenLayers<Linear = W>>(
        &self,
        layers: &mut L,
        x: &L::Value,
        modulation: &L::Value,
    ) -> Result<L::Value> {
        let normed = layers.norm_modulate(x, modulation, ATTENTION.0)?;
        layers.linear(&self.qkv, &normed)
    }

    /// The tokens `x` after the sub-block, given the result of the attention.
    pub(super) fn finish<L: TokenLayers<Linear = W>>(
        &self,
        layers: &mut L,
        x: L::Value,
        attended: &L::Value,
        modulation: &L::Value,
    ) -> Result<L::Value> {
        let x = layers.linear_gated(&self.out, attended, x, modulation, ATTENTION.1)?;
        let normed = layers.norm_modulate(&x, modulation, FEED_FORWARD.0)?;
        let hidden = layers.linear_swiglu(&self.up, &normed)?;
        layers.linear_gated(&self.down, &hidden, x, modulation, FEED_FORWARD.1)
    }
}
