//! Camera images between ROS messages and [`RgbImage`].
//!
//! Raw images are viewed in place through their row step ([`RosImage`] as an array view), compressed ones are decoded
//! within bounds. Every message comes from outside: sizes are checked before anything is allocated, and each error names
//! what was wrong.

use std::io::Cursor;

use cv_convert::{TryAsRefCv, TryToCv, ndarray};
use image::{ImageFormat, ImageReader, Limits, RgbImage, codecs::jpeg::JpegEncoder};
use ndarray::{ArrayView3, ShapeBuilder as _, s};
use thiserror::Error;
use wm_msgs::{
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
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
    #[error(
        "image encoding \"{0}\" is not supported; expected rgb8, bgr8, rgba8, bgra8, mono8 or mono16"
    )]
    Encoding(String),
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
        step: u32,
        /// Rows.
        height: u32,
    },
    /// A codec that is not supported.
    #[error("compressed image format \"{0}\" is not supported; expected jpeg or png")]
    Format(String),
    /// More compressed data than any frame needs.
    #[error("compressed image has {actual} bytes; expected at most {MAX_COMPRESSED}")]
    TooLarge {
        /// Bytes that came.
        actual: usize,
    },
    /// The codec refused the data, or the codec could not encode.
    #[error("compressed image ({format}): {source}")]
    Codec {
        /// The codec.
        format: &'static str,
        /// What it said.
        source: image::ImageError,
    },
}

/// A raw image message, to be read with cv-convert's traits.
#[derive(Clone, Copy, Debug)]
pub struct RosImage<'a>(pub &'a Image);

/// Where the colours of an encoding lie within a pixel.
struct PixelLayout {
    /// Bytes of a pixel.
    bytes: usize,
    /// Offsets of red, green and blue \[byte\].
    rgb: [usize; 3],
}

impl PixelLayout {
    fn of(image: &Image) -> Result<Self, ImageError> {
        Ok(match image.encoding.as_str() {
            "rgb8" => Self {
                bytes: 3,
                rgb: [0, 1, 2],
            },
            "bgr8" => Self {
                bytes: 3,
                rgb: [2, 1, 0],
            },
            "rgba8" => Self {
                bytes: 4,
                rgb: [0, 1, 2],
            },
            "bgra8" => Self {
                bytes: 4,
                rgb: [2, 1, 0],
            },
            "mono8" => Self {
                bytes: 1,
                rgb: [0; 3],
            },
            // The high byte is what 8 bits can show.
            "mono16" if image.is_bigendian != 0 => Self {
                bytes: 2,
                rgb: [0; 3],
            },
            "mono16" => Self {
                bytes: 2,
                rgb: [1; 3],
            },
            _ => return Err(ImageError::Encoding(image.encoding.clone())),
        })
    }
}

/// The bytes of every pixel, (height, width, bytes of a pixel), in place.
impl<'a> TryAsRefCv<'a, ArrayView3<'a, u8>> for RosImage<'a> {
    type Error = ImageError;

    fn try_as_ref_cv(&'a self) -> Result<ArrayView3<'a, u8>, ImageError> {
        let image = self.0;
        let (width, height) = (image.width, image.height);
        let layout = PixelLayout::of(image)?;
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
            return Err(ImageError::Size { width, height });
        }
        // Sides are bounded above: no product below overflows but step x height, which is widened.
        let (columns, rows, step) = (width as usize, height as usize, image.step as usize);
        let needed = columns * layout.bytes;
        if step < needed {
            return Err(ImageError::Step {
                step: image.step,
                width,
                encoding: image.encoding.clone(),
                needed,
            });
        }
        let wrong_data = |expected| ImageError::Data {
            actual: image.data.len(),
            expected,
            step: image.step,
            height,
        };
        let expected = step.saturating_mul(rows);
        if image.data.len() != expected {
            return Err(wrong_data(expected));
        }
        let shape = (rows, columns, layout.bytes).strides((step, layout.bytes, 1));
        ArrayView3::from_shape(shape, &image.data).map_err(|_| wrong_data(expected))
    }
}

impl TryToCv<RgbImage> for RosImage<'_> {
    type Error = ImageError;

    fn try_to_cv(&self) -> Result<RgbImage, ImageError> {
        let pixels = self.try_as_ref_cv()?;
        let rgb = PixelLayout::of(self.0)?.rgb;
        let mut data = vec![0; self.0.width as usize * self.0.height as usize * 3];
        for (channel, offset) in rgb.into_iter().enumerate() {
            let source = pixels.slice(s![.., .., offset]);
            data.iter_mut()
                .skip(channel)
                .step_by(3)
                .zip(source)
                .for_each(|(out, value)| *out = *value);
        }
        RgbImage::from_raw(self.0.width, self.0.height, data).ok_or(ImageError::Size {
            width: self.0.width,
            height: self.0.height,
        })
    }
}

/// A raw image message as RGB.
///
/// # Errors
/// [`ImageError`] names the field that is wrong.
pub fn decode_image(image: &Image) -> Result<RgbImage, ImageError> {
    RosImage(image).try_to_cv()
}

/// A compressed image message (JPEG or PNG) as RGB.
///
/// # Errors
/// [`ImageError::Format`], [`ImageError::TooLarge`], [`ImageError::Codec`].
pub fn decode_compressed(image: &CompressedImage) -> Result<RgbImage, ImageError> {
    // image_transport's longer form is "rgb8; jpeg compressed bgr8".
    let named = image.format.to_ascii_lowercase();
    let (format, name) = if named.contains("jpeg") || named.contains("jpg") {
        (ImageFormat::Jpeg, "jpeg")
    } else if named.contains("png") {
        (ImageFormat::Png, "png")
    } else {
        return Err(ImageError::Format(image.format.clone()));
    };
    if image.data.len() > MAX_COMPRESSED {
        return Err(ImageError::TooLarge {
            actual: image.data.len(),
        });
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODED);
    let mut reader = ImageReader::with_format(Cursor::new(&image.data), format);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|source| ImageError::Codec {
        format: name,
        source,
    })?;
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
