//! One prediction to one picture.

use image::RgbImage;
use thiserror::Error;
use wm_model::{Decoder, LatentSpace};
use wm_msgs::wm_msgs::Prediction;

use wm_camera::image_message::ImageError;
use wm_wire::latent_message::{LatentError, decode_latent};

/// Why a prediction gives no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DecoderError {
    /// The latent message cannot be used.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// The decoder cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
    /// The picture cannot be compressed.
    #[error(transparent)]
    Image(#[from] ImageError),
}

impl DecoderError {
    /// Why a prediction is dropped, for counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Latent(LatentError::Space { .. }) => "wrong_space",
            Self::Latent(_) | Self::Model(_) | Self::Image(_) => "bad_prediction",
        }
    }
}

/// The decoder node's computation: a prediction to a picture.
pub struct DecoderStep {
    decoder: Box<dyn Decoder>,
}

impl DecoderStep {
    /// A step that decodes with `decoder`.
    pub fn new(decoder: Box<dyn Decoder>) -> Self {
        Self { decoder }
    }

    /// The picture of a prediction, its latent checked against the decoder's space.
    ///
    /// # Errors
    /// [`DecoderError::Latent`] where the latent is of a different space or malformed, and the decoder's own.
    pub fn decode(&self, prediction: &Prediction) -> Result<RgbImage, DecoderError> {
        let values = decode_latent(&prediction.latent, self.decoder.space())?;
        Ok(self.decoder.picture(&values)?)
    }

    /// Decodes an empty latent: a trial, which also shows how long decoding takes.
    ///
    /// # Errors
    /// Those of the decoder.
    pub fn try_out(&self) -> Result<(), DecoderError> {
        let latent = vec![0.0; self.decoder.space().elements()];
        self.decoder.picture(&latent)?;
        Ok(())
    }

    /// The space of the latents that it decodes.
    pub fn space(&self) -> &LatentSpace {
        self.decoder.space()
    }

    /// Bytes of a raw picture's pixels.
    pub fn raw_bytes(&self) -> usize {
        let (height, width) = self.decoder.output_size();
        height * width * 3
    }
}

#[cfg(test)]
mod tests;
