//! The interface of every decoder.

use candle_core::Tensor;

use crate::{LatentSpace, Result};

/// Turns latents into images.
pub trait Decoder: Send + Sync {
    /// The space of the latents that go in.
    fn space(&self) -> &LatentSpace;

    /// Size (height, width) in pixels of the images that come out.
    fn output_size(&self) -> (usize, usize);

    /// Decodes normalised `latents` (N, h, w, C), f32, to images (N, H, W, 3), f32 in 0..1.
    ///
    /// # Errors
    /// If `latents` has another shape than the space.
    fn decode(&self, latents: &Tensor) -> Result<Tensor>;
}
