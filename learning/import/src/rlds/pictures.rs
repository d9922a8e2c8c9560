//! The pictures of a camera in an example.

use image::RgbImage;
use wm_camera::{format::Format, image_message::decode_compressed};
use wm_msgs::sensor_msgs::CompressedImage;

use crate::jpeg::encode_jpeg;

/// The frames of a camera as JPEG; existing JPEGs are not recoded.
pub(super) struct Pictures {
    frames: Vec<Vec<u8>>,
    is_flat: bool,
}

impl Pictures {
    /// Decodes every picture, as the nodes do.
    ///
    /// # Errors
    /// The step of an incomplete, damaged or unsupported picture.
    pub fn read(images: &[Vec<u8>], quality: u8) -> Result<Self, String> {
        let mut frames = Vec::with_capacity(images.len());
        let mut is_flat = true;
        for (step, bytes) in images.iter().enumerate() {
            let at_step = |error: String| format!("step {step}: {error}");
            let image = CompressedImage {
                data: bytes.clone(),
                ..CompressedImage::default()
            };
            let decoded = decode_compressed(&image).map_err(|error| at_step(error.to_string()))?;
            is_flat &= has_one_colour(&decoded);
            frames.push(match Format::of(&image) {
                Ok(Format::Jpeg) => image.data,
                _ => encode_jpeg(&decoded, quality).map_err(|error| at_step(error.to_string()))?,
            });
        }
        Ok(Self { frames, is_flat })
    }

    /// The frames; `None`, with a remark, for a missing camera, which RLDS fills with one flat colour. (The flags `has_image_N`
    /// do not help: they are all false in published files.)
    pub fn unless_flat(self, name: &str, notes: &mut Vec<String>) -> Option<Vec<Vec<u8>>> {
        if !self.is_flat {
            return Some(self.frames);
        }
        let name = name.strip_prefix("steps/observation/").unwrap_or(name);
        notes.push(format!(
            "{name} shows one flat colour in all frames: the camera is skipped"
        ));
        None
    }
}

fn has_one_colour(image: &RgbImage) -> bool {
    let mut pixels = image.pixels();
    pixels
        .next()
        .is_none_or(|first| pixels.all(|pixel| pixel == first))
}
