use std::io::Cursor;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::{ImageFormat, RgbImage, codecs::jpeg::JpegEncoder, imageops};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::judges::{Error, Result};

/// How frames are sent.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PictureSettings {
    /// What they are encoded as.
    pub format: PictureFormat,
    /// Of JPEG, 1 to 100.
    pub quality: u8,
    /// Larger ones are made smaller, to so many pixels on the longer side.
    pub max_side: Option<u32>,
    /// How closely the model looks, where the server knows the field.
    pub detail: Option<Detail>,
}

impl Default for PictureSettings {
    fn default() -> Self {
        Self {
            format: PictureFormat::Png,
            quality: 90,
            max_side: None,
            detail: None,
        }
    }
}

/// What frames are encoded as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureFormat {
    /// Without loss.
    Png,
    /// Smaller.
    Jpeg,
}

/// OpenAI's `detail` of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detail {
    /// A small version of the picture.
    Low,
    /// The picture in tiles.
    High,
    /// As the server likes.
    Auto,
}

/// An encoded frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// `data:image/png;base64,...`, or the same with JPEG.
    pub data_url: String,
    /// `sha256:...` of the frame's width and height (32 bits each, little-endian) and its pixels, before resizing and encoding.
    /// It does not depend on the encoder's version.
    pub pixel_hash: String,
}

impl Picture {
    /// Encodes frame `index`.
    ///
    /// # Errors
    /// If the frame has no pixels, or the encoder fails.
    pub fn encode(frame: &RgbImage, index: usize, settings: &PictureSettings) -> Result<Self> {
        let (width, height) = frame.dimensions();
        let failed = |problem| Error::Picture {
            frame: index,
            width,
            height,
            problem,
        };
        if width == 0 || height == 0 {
            return Err(failed("no pixels".to_owned()));
        }
        let smaller = settings.max_side.and_then(|side| shrink(frame, side));
        let sent = smaller.as_ref().unwrap_or(frame);
        let mut bytes = Vec::new();
        let (kind, encoded) = match settings.format {
            PictureFormat::Png => {
                let out = &mut Cursor::new(&mut bytes);
                ("png", sent.write_to(out, ImageFormat::Png))
            }
            PictureFormat::Jpeg => {
                let encoder = JpegEncoder::new_with_quality(&mut bytes, settings.quality);
                ("jpeg", sent.write_with_encoder(encoder))
            }
        };
        encoded.map_err(|error| failed(error.to_string()))?;
        let mut hash = Sha256::new();
        hash.update(width.to_le_bytes());
        hash.update(height.to_le_bytes());
        hash.update(frame.as_raw());
        Ok(Self {
            data_url: format!("data:image/{kind};base64,{}", STANDARD.encode(&bytes)),
            pixel_hash: format!("sha256:{:x}", hash.finalize()),
        })
    }
}

/// Shrinks the picture to `side` pixels on its longer side; `None` if it is not larger.
fn shrink(frame: &RgbImage, side: u32) -> Option<RgbImage> {
    let (width, height) = frame.dimensions();
    let longer = width.max(height);
    if longer <= side {
        return None;
    }
    // The product needs u64; the result is at most `side`.
    let scale = |length: u32| (u64::from(length) * u64::from(side) / u64::from(longer)) as u32;
    let (width, height) = (scale(width).max(1), scale(height).max(1));
    Some(imageops::resize(
        frame,
        width,
        height,
        imageops::FilterType::Triangle,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, 7]))
    }

    fn decode(picture: &Picture, kind: &str) -> RgbImage {
        let base64 = picture
            .data_url
            .strip_prefix(&format!("data:image/{kind};base64,"));
        let bytes = STANDARD.decode(base64.unwrap()).unwrap();
        image::load_from_memory(&bytes).unwrap().to_rgb8()
    }

    #[test]
    fn png_keeps_every_pixel() {
        let picture = Picture::encode(&frame(17, 5), 0, &PictureSettings::default()).unwrap();
        assert_eq!(decode(&picture, "png"), frame(17, 5));
        assert_eq!(picture.pixel_hash.len(), "sha256:".len() + 64);
    }

    #[test]
    fn pictures_shrink_but_never_grow() {
        let settings = PictureSettings {
            format: PictureFormat::Jpeg,
            max_side: Some(20),
            ..PictureSettings::default()
        };
        let side = |width, height| {
            let picture = Picture::encode(&frame(width, height), 0, &settings).unwrap();
            decode(&picture, "jpeg").dimensions()
        };
        assert_eq!(side(40, 30), (20, 15));
        assert_eq!(side(1, 100), (1, 20));
        assert_eq!(side(20, 3), (20, 3));
    }

    #[test]
    fn hash_depends_on_pixels_and_order() {
        let hash = |frame: &RgbImage, settings: &PictureSettings| {
            Picture::encode(frame, 0, settings).unwrap().pixel_hash
        };
        let png = PictureSettings::default();
        let jpeg = PictureSettings {
            format: PictureFormat::Jpeg,
            ..PictureSettings::default()
        };
        assert_eq!(hash(&frame(4, 6), &png), hash(&frame(4, 6), &jpeg));
        let turned = RgbImage::from_raw(6, 4, frame(4, 6).into_raw()).unwrap();
        assert_ne!(hash(&frame(4, 6), &png), hash(&turned, &png));
    }

    #[test]
    fn frame_without_pixels_is_rejected() {
        let error = Picture::encode(&frame(0, 5), 3, &PictureSettings::default()).unwrap_err();
        assert!(
            error.to_string().contains("frame 3 of 0x5 pixels"),
            "{error}"
        );
    }
}
