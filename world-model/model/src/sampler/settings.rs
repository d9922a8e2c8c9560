//! How to sample: what travels with weights and messages. Apart from the sampling itself, since the configuration of a
//! model names the settings that it was trained for.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// How a frame is integrated from noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sampler {
    /// Euler steps from noise level 1 to 0.
    pub steps: usize,
    /// Time shift gamma: levels are tau' = gamma tau / (1 + (gamma - 1) tau) of even ones.
    pub shift: f64,
    /// Noise level that clean context frames are said to have.
    pub context_tau: f64,
}

impl Default for Sampler {
    /// That of the reference for a latent that is not shifted: ten steps, context frames at 0.01.
    fn default() -> Self {
        Self {
            steps: 10,
            shift: 1.0,
            context_tau: 0.01,
        }
    }
}

impl Sampler {
    /// Checks the values.
    ///
    /// # Errors
    /// [`Error::Config`] with the first field that is wrong.
    pub fn validate(&self) -> Result<()> {
        if !(1..=10_000).contains(&self.steps) {
            let reason = format!("{}, expected 1 to 10000", self.steps);
            return Err(Error::config("steps", reason));
        }
        if !(self.shift.is_finite() && self.shift > 0.0) {
            let reason = format!("{}, expected a positive number", self.shift);
            return Err(Error::config("shift", reason));
        }
        if !(0.0..1.0).contains(&self.context_tau) {
            let reason = format!("{}, expected 0 up to 1", self.context_tau);
            return Err(Error::config("context_tau", reason));
        }
        Ok(())
    }

    /// The noise levels, `steps + 1` of them from 1 to 0.
    pub fn levels(&self) -> Vec<f64> {
        (0..=self.steps)
            .map(|i| shift_time(1.0 - i as f64 / self.steps as f64, self.shift))
            .collect()
    }
}

/// The time shift: gamma tau / (1 + (gamma - 1) tau), which keeps 0 and 1.
pub fn shift_time(tau: f64, gamma: f64) -> f64 {
    gamma * tau / (1.0 + (gamma - 1.0) * tau)
}
