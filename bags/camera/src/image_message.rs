//! Converts camera images between ROS messages and [`RgbImage`].
//!
//! Messages are not trusted: sizes are checked before any allocation, and each error names the fault.

use std::io::Cursor;

use cv_convert::TryToCv;
use image::{
    ColorType, DynamicImage, ImageDecoder as _, Limits, RgbImage,
    codecs::{jpeg::JpegEncoder, png::PngDecoder},
};
use wm_msgs::{
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};

pub use crate::{
    error::ImageError,
    limits::{MAX_COMPRESSED, MAX_SIDE},
};
use crate::{format::Format, jpeg, raw_image::RosImage};

/// Memory limit for decoding an image: [`MAX_SIDE`] squared at 3 bytes, with a margin \[bytes\].
const MAX_DECODED: u64 = 256 << 20;

/// Decodes a raw image message. As in cv_bridge, YUV is BT.601 in the limited range, and Bayer patterns are interpolated
/// linearly.
///
/// # Errors
/// [`ImageError`] names the invalid field.
pub fn decode_image(image: &Image) -> Result<RgbImage, ImageError> {
    RosImage(image).try_to_cv()
}

/// Decodes a compressed image message (JPEG or PNG). Its bytes decide the codec, since drivers fill `format` differently.
///
/// # Errors
/// [`ImageError::Format`], [`ImageError::Depth`], [`ImageError::TooLarge`], [`ImageError::Jpeg`], [`ImageError::Codec`].
pub fn decode_compressed(image: &CompressedImage) -> Result<RgbImage, ImageError> {
    match Format::of(image)? {
        Format::Jpeg => Ok(jpeg::decode(&image.data)?),
        Format::Png => png(&image.data),
    }
}

/// Decodes a JPEG or PNG with the checks of [`decode_compressed`].
pub fn decode_picture(data: Vec<u8>) -> Result<RgbImage, ImageError> {
    decode_compressed(&CompressedImage {
        data,
        ..CompressedImage::default()
    })
}

/// Checks that [`decode_compressed`] decodes this message; returns its codec, columns and rows. Far faster for JPEG, which
/// is not decoded.
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

/// Encodes a raw message (rgb8, rows without padding).
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

/// Encodes a JPEG message; `quality` from 1 to 100.
///
/// # Errors
/// [`ImageError::Codec`] if the image is too large for JPEG, or empty.
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
