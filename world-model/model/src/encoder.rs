//! The interface of every encoder.

use candle_core::Tensor;

use crate::{LatentSpace, Result};

/// Turns camera frames into latents. Encoders are frozen: they never change once loaded.
pub trait Encoder: Send + Sync {
    /// The space of the latents that come out.
    fn space(&self) -> &LatentSpace;

    /// Size (height, width) in pixels of the images that go in; see [`crate::image::preprocess`].
    fn input_size(&self) -> (usize, usize);

    /// Encodes `images` (N, H, W, 3), f32 in 0..1, to normalised latents (N, h, w, C), f32.
    ///
    /// # Errors
    /// If `images` has another shape than the input size asks for.
    fn encode(&self, images: &Tensor) -> Result<Tensor>;
}
