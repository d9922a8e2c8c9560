//! Planning: which actions bring the latent that the camera sees to the latent of a goal.
//!
//! [`Cem`] is the cross-entropy method over a diagonal Gaussian of action values. It asks a [`Dynamics`] what
//! candidates lead to and a [`Target`] what that costs; it holds no model, no clock and no robot. The transition model
//! serves it by [`TransitionDynamics`], which shares one cached context and one fixed noise among all candidates.
//!
//! Everything here is in model units; [`wm_motion::actions::ActionEncoding`] turns a plan into metres and radians.

mod cem;
mod error;
mod partial;
mod settings;
mod target;
mod transition_dynamics;

use candle_core::Tensor;

pub use cem::{Cem, PlannedActions};
pub use error::PlanError;
pub use partial::Partial;
pub use settings::{CemSettings, Returned};
pub use target::Target;
pub use transition_dynamics::TransitionDynamics;

/// What comes of a sequence of actions. One value of this type serves one plan: its context and its noise are fixed, so
/// that candidates differ by their actions only.
pub trait Dynamics {
    /// Length A of a model action.
    fn action_dim(&self) -> usize;

    /// Latents after each of k model steps, for N candidates at once: `actions` (N, k, A) f32 in model units to
    /// (N, k, h, w, C) f32, normalised.
    ///
    /// # Errors
    /// Whatever the model cannot compute.
    fn rollout(&mut self, actions: &Tensor) -> crate::Result<Tensor>;
}
