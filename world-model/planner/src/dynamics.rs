//! The world as a plan sees it: actions in, latents out.

use candle_core::Tensor;
use wm_model::Result;

/// Predicts the latents after a sequence of actions. One value serves one plan: context and noise are fixed, so that
/// candidates differ only by their actions.
pub trait Dynamics {
    /// Length A of a model action.
    fn action_dim(&self) -> usize;

    /// The latent that all candidates start from, (h, w, C) f32, normalised.
    ///
    /// # Errors
    /// Those of the model.
    fn start(&self) -> Result<Tensor>;

    /// Latents after each of k model steps, for N candidates at once: `actions` (N, k, A) f32 in model units to
    /// (N, k, h, w, C) f32, normalised.
    ///
    /// # Errors
    /// Those of the model.
    fn rollout(&mut self, actions: &Tensor) -> Result<Tensor>;
}
