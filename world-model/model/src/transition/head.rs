//! From tokens back to patches.

use candle_core::Tensor;

use super::TransitionConfig;
use super::embedding::Condition;
use super::parameters::{Linear, Tensors};
use crate::ops::{Engine, rms_norm_modulate};
use crate::{Error, Result};

/// The last layers.
#[derive(Clone, Debug)]
pub(super) struct Head {
    /// The wide head's projection; the plain head has none.
    pub(super) wide: Option<Linear>,
    pub(super) modulation: Linear,
    pub(super) linear: Linear,
}

/// Name of the wide head's projection.
pub(super) const WIDE: &str = "s_projector";

/// What the names of the head's last two layers start with.
pub(super) fn name(config: &TransitionConfig) -> &'static str {
    match config.wide_head {
        Some(_) => "head_final_layer",
        None => "final_layer",
    }
}

impl Head {
    pub(super) fn new(config: &TransitionConfig, tensors: &mut Tensors) -> Result<Self> {
        let (wide, name) = (config.wide_head, name(config));
        Ok(Self {
            wide: wide.map(|_| tensors.linear(WIDE)).transpose()?,
            modulation: tensors.linear(&format!("{name}.adaLN_modulation.1"))?,
            linear: tensors.linear(&format!("{name}.linear"))?,
        })
    }

    /// Tokens (B, T, N, d) to patches (B, T, N, p * p * C).
    pub(super) fn forward(
        &self,
        engine: Engine,
        tokens: &Tensor,
        condition: &Condition,
    ) -> Result<Tensor> {
        let modulation = self.plain_modulation(engine, &condition.activated)?;
        self.forward_modulated(engine, tokens, modulation.as_ref(), &condition.time)
    }

    /// What modulates the plain head, for `activated` (rows, d); the wide one makes its own of the tokens.
    pub(super) fn plain_modulation(
        &self,
        engine: Engine,
        activated: &Tensor,
    ) -> Result<Option<Tensor>> {
        match &self.wide {
            None => self.modulation.forward(engine, activated).map(Some),
            Some(_) => Ok(None),
        }
    }

    /// As [`Self::forward`], given [`Self::plain_modulation`] and the time embedding (frames, d).
    pub(super) fn forward_modulated(
        &self,
        engine: Engine,
        tokens: &Tensor,
        modulation: Option<&Tensor>,
        time: &Tensor,
    ) -> Result<Tensor> {
        let (b, t, n, d) = tokens.dims4()?;
        let (tokens, modulation) = match (&self.wide, modulation) {
            (None, Some(modulation)) => (tokens.clone(), modulation.clone()),
            (None, None) => return Err(Error::config("head", "its modulation is missing")),
            (Some(project), _) => {
                // The wide head is conditioned on the noise level here, and from then on only on
                // what it made of the frame.
                let frames = tokens.reshape((b * t, n, d))?;
                let timed = frames.broadcast_add(&time.unsqueeze(1)?)?;
                let wide = project.forward(engine, &timed.silu()?)?;
                let activated = wide.mean(1)?.silu()?;
                (wide, self.modulation.forward(engine, &activated)?)
            }
        };
        let normed = rms_norm_modulate(engine, &tokens, &modulation, 0, 1)?;
        Ok(self
            .linear
            .forward(engine, &normed)?
            .reshape((b, t, n, ()))?)
    }
}
