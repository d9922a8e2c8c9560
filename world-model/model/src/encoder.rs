//! The interface of every encoder.

use candle_core::Tensor;
use image::RgbImage;

use crate::{Framing, LatentSpace, Result};

/// Turns camera frames into latents. Encoders are frozen: they never change once loaded.
pub trait Encoder: Send + Sync {
    /// The space of the latents that come out.
    fn space(&self) -> &LatentSpace;

    /// Size (height, width) in pixels of the images that go in.
    fn input_size(&self) -> (usize, usize);

    /// How a camera's picture becomes such an image. Encoders without a rule of their own were trained on stretched
    /// pictures.
    fn framing(&self) -> Framing {
        Framing::from(self.input_size())
    }

    /// A camera's picture as [`Encoder::encode`] takes it: (1, H, W, 3).
    ///
    /// # Errors
    /// If the picture is empty.
    fn prepare(&self, picture: &RgbImage) -> Result<Tensor> {
        self.framing().tensor(picture)
    }

    /// Encodes `images` (N, H, W, 3), f32 in 0..1, to normalised latents (N, h, w, C), f32.
    ///
    /// # Errors
    /// If `images` has another shape than the input size asks for.
    fn encode(&self, images: &Tensor) -> Result<Tensor>;

    /// The latent of one image of [`Encoder::prepare`], row-major, channels last.
    ///
    /// # Errors
    /// As [`Encoder::encode`].
    fn values(&self, image: &Tensor) -> Result<Vec<f32>> {
        Ok(self.encode(image)?.flatten_all()?.to_vec1()?)
    }
}
