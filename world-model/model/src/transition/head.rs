//! From tokens back to patches.

use candle_core::Tensor;

use super::TransitionConfig;
use super::linear_layer::Initialisation::{Xavier, Zero};
use super::linear_layer::{LinearLayer, LinearSource};
use crate::ops::token_layers::{HeadLayers, Linear, TensorLayers};
use crate::{Error, Result};

/// The last layers.
#[derive(Clone, Debug)]
pub(super) struct Head<W> {
    /// The wide head's projection; the plain head has none.
    pub(super) wide: Option<W>,
    modulation: W,
    pub(super) linear: W,
}

impl<W> Head<W> {
    pub(super) fn new(
        config: &TransitionConfig,
        source: &mut impl LinearSource<Linear = W>,
    ) -> Result<Self> {
        let (name, width) = match config.wide_head {
            Some(width) => ("head_final_layer", width),
            None => ("final_layer", config.hidden),
        };
        let layer = LinearLayer::new;
        let projection = layer(width, config.hidden, Xavier);
        let modulation = layer(2 * width, width, Zero).sensitive();
        let linear = layer(config.patch_values(), width, Zero).sensitive();
        let wide = config.wide_head;
        let wide = wide.map(|_| source.linear("s_projector", projection));
        Ok(Self {
            wide: wide.transpose()?,
            modulation: source.linear(&format!("{name}.adaLN_modulation.1"), modulation)?,
            linear: source.linear(&format!("{name}.linear"), linear)?,
        })
    }

    /// The modulation of the plain head, for `activated` (rows, d); the wide one makes its own of the tokens.
    pub(super) fn plain_modulation<L: HeadLayers<Linear = W>>(
        &self,
        layers: &mut L,
        activated: &L::Value,
    ) -> Result<Option<L::Value>> {
        match &self.wide {
            None => layers.linear(&self.modulation, activated).map(Some),
            Some(_) => Ok(None),
        }
    }

    /// The tokens of the wide head, whose projection is `wide`, for frames of these time embeddings.
    pub(super) fn widened<L: HeadLayers<Linear = W>>(
        layers: &mut L,
        wide: &W,
        tokens: &L::Value,
        time: &L::Value,
    ) -> Result<L::Value> {
        // The wide head is conditioned on the noise level here, and from then on only on what it made of the frame.
        let timed = layers.add_to_frames(tokens, time)?;
        let timed = layers.silu(timed)?;
        layers.linear(wide, &timed)
    }

    /// The wide head's modulation, for the `means` of its tokens over each frame.
    pub(super) fn wide_modulation<L: HeadLayers<Linear = W>>(
        &self,
        layers: &mut L,
        means: L::Value,
    ) -> Result<L::Value> {
        let activated = layers.silu(means)?;
        layers.linear(&self.modulation, &activated)
    }

    /// Patches of tokens, wide ones for the wide head, whose frames have this modulation.
    pub(super) fn patches<L: HeadLayers<Linear = W>>(
        &self,
        layers: &mut L,
        tokens: &L::Value,
        modulation: &L::Value,
    ) -> Result<L::Value> {
        let normed = layers.norm_modulate(tokens, modulation, 0)?;
        layers.linear(&self.linear, &normed)
    }
}

impl Head<Linear> {
    /// Tokens (B, T, N, d) to patches (B, T, N, p * p * C), given [`Head::plain_modulation`] and the time embedding
    /// (frames, d).
    pub(super) fn forward(
        &self,
        layers: &mut TensorLayers,
        tokens: &Tensor,
        modulation: Option<&Tensor>,
        time: &Tensor,
    ) -> Result<Tensor> {
        if let Some(wide) = &self.wide {
            let wide = Self::widened(layers, wide, tokens, time)?;
            let modulation = self.wide_modulation(layers, wide.mean(2)?.flatten_to(1)?)?;
            return self.patches(layers, &wide, &modulation);
        }
        let missing = || Error::config("head", "its modulation is missing");
        self.patches(layers, tokens, modulation.ok_or_else(missing)?)
    }
}
