//! Codecs of compressed pictures, detected by their bytes.

use wm_msgs::sensor_msgs::CompressedImage;

use crate::{error::ImageError, limits::MAX_COMPRESSED};

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Size of the header of compressed_depth_image_transport: a kind and two numbers.
const DEPTH_HEADER: usize = 12;
/// Limit of an unknown `format` in an error \[characters\].
const LONGEST_NAME: usize = 64;

/// A supported codec.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
}

impl Format {
    /// Detects the codec of a message.
    ///
    /// # Errors
    /// [`ImageError::Format`], [`ImageError::Depth`], [`ImageError::TooLarge`].
    pub fn of(image: &CompressedImage) -> Result<Self, ImageError> {
        let data = image.data.as_slice();
        if data.len() > MAX_COMPRESSED {
            return Err(ImageError::TooLarge { actual: data.len() });
        }
        if data.starts_with(b"\xff\xd8") {
            return Ok(Self::Jpeg);
        }
        if data.starts_with(PNG) {
            return Ok(Self::Png);
        }
        let format: String = image.format.chars().take(LONGEST_NAME).collect();
        let is_depth = format.contains("compressedDepth")
            || data
                .get(DEPTH_HEADER..)
                .is_some_and(|data| data.starts_with(PNG));
        match is_depth {
            true => Err(ImageError::Depth(format)),
            false => Err(ImageError::Format {
                found: name_codec(data),
                format,
            }),
        }
    }
}

fn name_codec(data: &[u8]) -> &'static str {
    match data {
        [] => "empty",
        [
            b'R',
            b'I',
            b'F',
            b'F',
            _,
            _,
            _,
            _,
            b'W',
            b'E',
            b'B',
            b'P',
            ..,
        ] => "WebP",
        [b'G', b'I', b'F', b'8', ..] => "GIF",
        [b'B', b'M', ..] => "BMP",
        [b'I', b'I', b'*', 0, ..] | [b'M', b'M', 0, b'*', ..] => "TIFF",
        [0x28, 0xb5, 0x2f, 0xfd, ..] => "compressed by zstd",
        [0, 0, 0, 1, ..] | [0, 0, 1, ..] => "h264 or h265 video",
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => "AVIF or HEIF",
        [0xff, 0x0a, ..] | [0, 0, 0, 0x0c, b'J', b'X', b'L', ..] => "JPEG XL",
        [0xff, 0x4f, 0xff, 0x51, ..] | [0, 0, 0, 0x0c, b'j', b'P', ..] => "JPEG 2000",
        _ => "of an unknown format",
    }
}
