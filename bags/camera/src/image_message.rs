//! Camera images between ROS messages and [`RgbImage`].
//!
//! Every message comes from outside: sizes are checked before anything is allocated, and each error names what was wrong.

use std::io::Cursor;

use cv_convert::TryToCv;
use image::{
    ColorType, DynamicImage, ImageDecoder as _, Limits, RgbImage,
    codecs::{jpeg::JpegEncoder, png::PngDecoder},
};
use thiserror::Error;
use wm_msgs::{
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};

use crate::{
    encoding::SUPPORTED,
    format::Format,
    jpeg::{self, JpegError},
    raw_image::RosImage,
};

/// Longest side of an image that is accepted \[px\]: 8K cameras and no more.
pub const MAX_SIDE: u32 = 8192;
/// Longest compressed image that is accepted \[byte\].
pub const MAX_COMPRESSED: usize = 32 << 20;
/// Most memory that decoding a compressed image may take \[byte\]: an image of [`MAX_SIDE`] at 3 bytes, and some room.
const MAX_DECODED: u64 = 256 << 20;

/// Why an image message is no image.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ImageError {
    /// A pixel format that is not supported.
    #[error("image encoding \"{0}\" is not supported; expected {SUPPORTED}")]
    Encoding(String),
    /// Distances, or other values of more than 8 bits: almost black as a picture.
    #[error(
        "\"{0}\" is a depth picture, or grey of more than 8 bits, and not supported as a camera; choose the colour camera's \
         topic, or publish mono8"
    )]
    Depth(String),
    /// No pixel, or too many.
    #[error("image of {width}x{height} pixels; each side must be 1 to {MAX_SIDE}")]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Rows that overlap.
    #[error("image step is {step} bytes; {width} pixels of {encoding} need at least {needed}")]
    Step {
        /// What the message says \[byte\].
        step: u32,
        /// Columns.
        width: u32,
        /// The pixel format.
        encoding: String,
        /// Bytes of a row.
        needed: usize,
    },
    /// Not as much data as step and height say.
    #[error("image data has {actual} bytes; step {step} x height {height} need {expected}")]
    Data {
        /// Bytes that came.
        actual: usize,
        /// Bytes that were announced.
        expected: usize,
        /// Row step \[byte\].
        step: usize,
        /// Rows.
        height: u32,
    },
    /// Bytes of a codec that is not supported, and what the message says of them.
    #[error(
        "compressed image is {found} (format \"{format}\"), which is not supported; expected JPEG or PNG"
    )]
    Format {
        /// What the bytes are.
        found: &'static str,
        /// The message's `format`.
        format: String,
    },
    /// More compressed data than any frame needs.
    #[error("compressed image has {actual} bytes; expected at most {MAX_COMPRESSED}")]
    TooLarge {
        /// Bytes that came.
        actual: usize,
    },
    /// The JPEG is incomplete, damaged or of a layout that is not supported.
    #[error("compressed image (jpeg): {0}")]
    Jpeg(#[from] JpegError),
    /// The codec refused the data, or the codec could not encode.
    #[error("compressed image ({format}): {source}")]
    Codec {
        /// The codec.
        format: &'static str,
        /// What it said.
        source: image::ImageError,
    },
}

impl ImageError {
    /// Whether all pictures of the same camera will have it: it is of their format, not of their bytes.
    pub fn is_of_format(&self) -> bool {
        matches!(
            self,
            Self::Encoding(_)
                | Self::Depth(_)
                | Self::Format { .. }
                | Self::Jpeg(JpegError::Layout(_))
        )
    }
}

/// A raw image message as RGB. YUV is taken as BT.601 in the limited range, as cv_bridge does; Bayer patterns are
/// interpolated linearly.
///
/// # Errors
/// [`ImageError`] names the field that is wrong.
pub fn decode_image(image: &Image) -> Result<RgbImage, ImageError> {
    RosImage(image).try_to_cv()
}

/// A compressed image message (JPEG or PNG) as RGB. The bytes decide which it is: drivers write many things into `format`.
///
/// # Errors
/// [`ImageError::Format`], [`ImageError::Depth`], [`ImageError::TooLarge`], [`ImageError::Jpeg`], [`ImageError::Codec`].
pub fn decode_compressed(image: &CompressedImage) -> Result<RgbImage, ImageError> {
    match Format::of(image)? {
        Format::Jpeg => Ok(jpeg::decode(&image.data)?),
        Format::Png => png(&image.data),
    }
}

/// The bytes of a JPEG or PNG as RGB, with the checks of [`decode_compressed`].
///
/// # Errors
/// As [`decode_compressed`].
pub fn decode_picture(data: Vec<u8>) -> Result<RgbImage, ImageError> {
    decode_compressed(&CompressedImage {
        data,
        ..CompressedImage::default()
    })
}

/// Format, columns and rows of a compressed image message that is a complete picture, and that [`decode_compressed`]
/// decodes. A JPEG is not decoded for it, which takes a fraction of the time.
///
/// # Errors
/// As [`decode_compressed`].
pub fn check_compressed(image: &CompressedImage) -> Result<(Format, (u32, u32)), ImageError> {
    let format = Format::of(image)?;
    let size = match format {
        Format::Jpeg => jpeg::check(&image.data)?,
        Format::Png => png(&image.data)?.dimensions(),
    };
    Ok((format, size))
}

fn png(data: &[u8]) -> Result<RgbImage, ImageError> {
    let wrong = |source| ImageError::Codec {
        format: "png",
        source,
    };
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODED);
    let decoder = PngDecoder::with_limits(Cursor::new(data), limits.clone()).map_err(wrong)?;
    if matches!(decoder.color_type(), ColorType::L16 | ColorType::La16) {
        return Err(ImageError::Depth("PNG of 16 bits grey".to_owned()));
    }
    let mut decoder = decoder;
    decoder.set_limits(limits).map_err(wrong)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(wrong)?;
    Ok(decoded.into_rgb8())
}

/// An RGB image as a raw message (rgb8, rows without padding).
pub fn encode_image(rgb: &RgbImage, header: Header) -> Image {
    Image {
        header,
        height: rgb.height(),
        width: rgb.width(),
        encoding: "rgb8".into(),
        is_bigendian: 0,
        step: rgb.width() * 3,
        data: rgb.as_raw().clone(),
    }
}

/// An RGB image as a JPEG message; `quality` from 1 to 100.
///
/// # Errors
/// [`ImageError::Codec`] where the image is too large for JPEG, or empty.
pub fn encode_jpeg(
    rgb: &RgbImage,
    header: Header,
    quality: u8,
) -> Result<CompressedImage, ImageError> {
    let mut data = Vec::new();
    JpegEncoder::new_with_quality(&mut data, quality.clamp(1, 100))
        .encode_image(rgb)
        .map_err(|source| ImageError::Codec {
            format: "jpeg",
            source,
        })?;
    Ok(CompressedImage {
        header,
        format: "jpeg".into(),
        data,
    })
}

#[cfg(test)]
mod tests;
