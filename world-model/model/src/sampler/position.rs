//! Where a rollout is, as plain tensors.

use candle_core::{Device, Tensor};

use super::{Noise, Rollout, Sampler};
use crate::transition::LoadedTransition;
use crate::{Error, Result};

/// Where a rollout is. One that begins there goes on as this one would, bit for bit.
#[derive(Clone, Debug)]
pub struct Position {
    /// The frames that the next prediction sees, observed or predicted: (1, T, H, W, C), the oldest first.
    pub context: Tensor,
    /// The actions between them, (T - 1, A); `None` for T = 1.
    pub actions: Option<Tensor>,
    /// The noise of the next prediction.
    pub noise: Noise,
}

impl<'m> Rollout<'m> {
    /// Goes on from the `position` of another rollout.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn resume(
        model: &'m LoadedTransition,
        sampler: &Sampler,
        position: &Position,
    ) -> Result<Self> {
        let actions = position.actions.as_ref();
        let actions = actions.map(|actions| actions.unsqueeze(0)).transpose()?;
        let (context, noise) = (&position.context, position.noise);
        Self::batch(model, sampler, context, actions.as_ref(), &[noise])
    }

    /// Where it is.
    ///
    /// # Errors
    /// If this is several candidates.
    pub fn position(&self) -> Result<Position> {
        let noise = match (&*self.noise, self.candidates) {
            ([noise], 1) => *noise,
            (_, candidates) => {
                let reason = format!("the position of {candidates} was asked for");
                return Err(Error::config("candidates", reason));
            }
        };
        let c = self.model.config();
        let grid = (c.latent_height, c.latent_width, c.channels);
        let (frames, actions) = self.window.values()?;
        let count = frames.len() / (grid.0 * grid.1 * grid.2);
        let context = (1, count, grid.0, grid.1, grid.2);
        let between = (count.saturating_sub(1), c.action_dim);
        Ok(Position {
            context: Tensor::from_vec(frames, context, &Device::Cpu)?,
            actions: match actions.is_empty() {
                true => None,
                false => Some(Tensor::from_vec(actions, between, &Device::Cpu)?),
            },
            noise: Noise {
                first_step: noise.first_step + self.steps_taken,
                ..noise
            },
        })
    }
}
