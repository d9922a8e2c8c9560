//! What comes of actions.

use candle_core::Tensor;
use wm_model::Result;

/// What comes of a sequence of actions. One value of this type serves one plan: its context and its noise are fixed, so
/// that candidates differ by their actions only.
pub trait Dynamics {
    /// Length A of a model action.
    fn action_dim(&self) -> usize;

    /// The latent that all candidates start from, (h, w, C) f32, normalised.
    ///
    /// # Errors
    /// Whatever the model cannot compute.
    fn start(&self) -> Result<Tensor>;

    /// Latents after each of k model steps, for N candidates at once: `actions` (N, k, A) f32 in model units to
    /// (N, k, h, w, C) f32, normalised.
    ///
    /// # Errors
    /// Whatever the model cannot compute.
    fn rollout(&mut self, actions: &Tensor) -> Result<Tensor>;
}
