//! One image to one latent.

use image::RgbImage;
use thiserror::Error;
use wm_model::{Encoder, Framing};
use wm_msgs::{std_msgs::Header, wm_msgs::Latent};
use wm_zoo::ModelFolder;

use wm_camera::{camera_frame::CameraFrame, image_message::ImageError};
use wm_ros::frame_trace;
use wm_wire::latent_message::{LatentDtype, LatentError, encode_latent};

/// Least side of a picture that shows a scene \[px\].
const LEAST_SIDE: u32 = 8;

/// Why an image has no latent.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EncoderError {
    /// The message is not a valid image.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A picture too small to show a scene.
    #[error("picture of {width}x{height} pixels; each side must be at least {LEAST_SIDE}")]
    Small {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The encoder cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
    /// The latent does not fit its message.
    #[error(transparent)]
    Latent(#[from] LatentError),
}

/// The encoder node's computation: an image message to a latent message of the same stamp.
pub struct EncoderStep {
    encoder: Box<dyn Encoder>,
    framing: Framing,
    dtype: LatentDtype,
}

impl EncoderStep {
    /// A step that encodes with `encoder` and publishes numbers as `dtype`.
    pub fn new(encoder: Box<dyn Encoder>, dtype: LatentDtype) -> Self {
        let framing = encoder.framing();
        Self {
            encoder,
            framing,
            dtype,
        }
    }

    /// A step with the encoder of `model`, whose pictures show as many cameras side by side as in its training.
    ///
    /// # Errors
    /// Names missing and wrong weights; or the device cannot be used or has no memory for it.
    pub fn of_model(model: &ModelFolder, dtype: LatentDtype) -> wm_zoo::Result<Self> {
        Ok(Self {
            framing: model.framing()?,
            ..Self::new(model.encoder()?, dtype)
        })
    }

    /// The latent message of a frame.
    ///
    /// # Errors
    /// [`EncoderError`] says whether the image, the model or the latent is at fault.
    pub fn encode(&self, frame: &CameraFrame) -> Result<Latent, EncoderError> {
        self.encode_picture(&frame.decode()?, frame.header())
    }

    /// The latent message of a picture.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn encode_picture(
        &self,
        picture: &RgbImage,
        header: &Header,
    ) -> Result<Latent, EncoderError> {
        expect_scene(picture)?;
        let image = self.framing.tensor(picture)?;
        frame_trace::passed("picture resized", header.stamp);
        let values = self.encoder.values(&image)?;
        frame_trace::passed("latent computed", header.stamp);
        let space = self.encoder.space();
        Ok(encode_latent(&values, space, self.dtype, header.clone())?)
    }

    /// A picture as the encoder takes it.
    ///
    /// # Errors
    /// [`EncoderError::Small`], or the picture does not fit the encoder.
    pub fn framed(&self, picture: &RgbImage) -> Result<RgbImage, EncoderError> {
        expect_scene(picture)?;
        Ok(self.framing.apply(picture)?)
    }

    /// The latent of an image, row-major, channels last.
    ///
    /// # Errors
    /// [`EncoderError::Small`], and those of the encoder.
    pub fn encode_values(&self, rgb: &RgbImage) -> Result<Vec<f32>, EncoderError> {
        expect_scene(rgb)?;
        Ok(self.encoder.values(&self.framing.tensor(rgb)?)?)
    }

    /// Encodes a grey picture: a trial, which also shows how long encoding takes.
    ///
    /// # Errors
    /// Those of the encoder.
    pub fn try_out(&self) -> Result<(), EncoderError> {
        let (height, width) = self.encoder.input_size();
        // A side beyond 32 bits fits no picture.
        let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
        let grey = RgbImage::from_pixel(side(width), side(height), image::Rgb([128; 3]));
        self.encode_values(&grey).map(|_| ())
    }

    /// How pictures are fitted to the encoder.
    pub fn framing(&self) -> Framing {
        self.framing
    }

    /// The space of its latents.
    pub fn space(&self) -> &wm_model::LatentSpace {
        self.encoder.space()
    }
}

/// That a picture is large enough to show a scene.
pub(crate) fn expect_scene(rgb: &RgbImage) -> Result<(), EncoderError> {
    let (width, height) = rgb.dimensions();
    match width.min(height) < LEAST_SIDE {
        true => Err(EncoderError::Small { width, height }),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests;
