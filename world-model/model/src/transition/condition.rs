//! From noise levels and actions to the modulation of the layers.

use super::TransitionConfig;
use super::linear_layer::Initialisation::{Normal, Xavier};
use super::linear_layer::{LinearLayer, LinearSource};
use crate::Result;
use crate::ops::token_layers::{ClipLayers, HeadLayers};

/// Frequencies of the noise level's sinusoid; it has a cosine and a sine of each.
pub(super) const FREQUENCIES: usize = 128;

/// Ratio of the highest frequency to that which follows the lowest.
const FREQUENCY_RANGE: f64 = 10_000.0;

/// tau in 0..1 is stretched to this range before the sinusoid.
const TAU_SCALE: f64 = 1_000.0;

/// Time embedding and action embedding.
#[derive(Clone, Debug)]
pub(super) struct ConditionEmbedding<W> {
    time: [W; 2],
    action: W,
}

/// The embeddings of noise levels and actions; rows are the frames of the batch, (B T, d).
#[derive(Clone, Debug)]
pub(super) struct Condition<V> {
    /// Time embedding alone.
    pub(super) time: V,
    /// SiLU of time plus action embedding, from which every modulation starts.
    pub(super) activated: V,
}

/// Radians of each wave at noise level 1.
pub(super) fn frequencies() -> Vec<f32> {
    (0..FREQUENCIES)
        .map(|i| {
            let exponent = -FREQUENCY_RANGE.ln() * i as f64 / FREQUENCIES as f64;
            (exponent.exp() * TAU_SCALE) as f32
        })
        .collect()
}

impl<W> ConditionEmbedding<W> {
    pub(super) fn new(
        config: &TransitionConfig,
        source: &mut impl LinearSource<Linear = W>,
    ) -> Result<Self> {
        let d = config.hidden;
        let mut linear = |name, inputs, initialisation| {
            source.linear(
                name,
                LinearLayer::new(d, inputs, initialisation).sensitive(),
            )
        };
        Ok(Self {
            time: [
                linear("timestep_mlp.0", 2 * FREQUENCIES, Normal(0.02))?,
                linear("timestep_mlp.2", d, Normal(0.02))?,
            ],
            action: linear("action_embedder", config.action_dim, Xavier)?,
        })
    }

    /// Of cosines and sines of the noise levels (frames, 2 frequencies), and actions (frames, A).
    pub(super) fn at<L: HeadLayers<Linear = W>>(
        &self,
        layers: &mut L,
        waves: &L::Value,
        action: &L::Value,
    ) -> Result<Condition<L::Value>> {
        let [first, second] = &self.time;
        let hidden = layers.linear(first, waves)?;
        let hidden = layers.silu(hidden)?;
        let time = layers.linear(second, &hidden)?;
        let action = layers.linear(&self.action, action)?;
        let sum = layers.sum(action, &time)?;
        let activated = layers.silu(sum)?;
        Ok(Condition { time, activated })
    }
}

impl<V> Condition<V> {
    /// That of the last `last` frames of each clip.
    pub(super) fn last_frames<L: ClipLayers<Value = V>>(
        self,
        layers: &mut L,
        last: usize,
    ) -> Result<Self> {
        Ok(Self {
            time: layers.last_frames(self.time, last)?,
            activated: layers.last_frames(self.activated, last)?,
        })
    }
}
