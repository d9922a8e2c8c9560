//! The interface of every decoder.

use candle_core::Tensor;
use image::RgbImage;

use crate::image::to_rgb;
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

    /// The picture of one normalised `latent`, row-major, channels last.
    ///
    /// # Errors
    /// If the latent has another number of values than the space, or the decoder fails.
    fn picture(&self, latent: &[f32]) -> Result<RgbImage> {
        let latent = self.space().stack(&[latent])?;
        to_rgb(&self.decode(&latent)?.squeeze(0)?)
    }
}
