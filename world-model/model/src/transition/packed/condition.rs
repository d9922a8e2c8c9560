//! From noise levels and actions to what modulates the layers.

use super::source::NamedLayers;
use crate::Result;
use crate::ops::PackedLinear;
use crate::ops::activation::silu_chunk as silu;
use crate::transition::embedding::frequencies;

/// Time and action embedding.
#[derive(Debug)]
pub(super) struct Condition {
    frequencies: Vec<f32>,
    time: [PackedLinear; 2],
    action: PackedLinear,
}

/// Noise levels and actions as embeddings; rows are frames.
pub(super) struct Conditions {
    /// Time embedding alone (frames, d).
    pub(super) time: Vec<f32>,
    /// SiLU of time plus action embedding (frames, d).
    pub(super) activated: Vec<f32>,
}

impl Condition {
    pub(super) fn new(layers: &NamedLayers<'_>) -> Result<Self> {
        // What comes out meets every token of a frame.
        Ok(Self {
            frequencies: frequencies(),
            time: [
                layers.sensitive("timestep_mlp.0")?,
                layers.sensitive("timestep_mlp.2")?,
            ],
            action: layers.sensitive("action_embedder")?,
        })
    }

    /// For `tau` (frames) and `action` (frames, A).
    pub(super) fn at(&self, tau: &[f32], action: &[f32]) -> Conditions {
        let mut waves = Vec::with_capacity(tau.len() * 2 * self.frequencies.len());
        for tau in tau {
            waves.extend(self.frequencies.iter().map(|f| (f * tau).cos()));
            waves.extend(self.frequencies.iter().map(|f| (f * tau).sin()));
        }
        let [first, second] = &self.time;
        let mut hidden = product(first, &waves, tau.len());
        silu(&mut hidden);
        let time = product(second, &hidden, tau.len());
        let mut activated = product(&self.action, action, tau.len());
        for (sum, time) in activated.iter_mut().zip(&time) {
            *sum += time;
        }
        silu(&mut activated);
        Conditions { time, activated }
    }
}

/// The product of `x`, which has so many rows.
pub(super) fn product(linear: &PackedLinear, x: &[f32], rows: usize) -> Vec<f32> {
    let mut y = vec![0.0; rows * linear.outputs()];
    linear.forward(x, &mut y);
    y
}
