//! Faults of image messages.

use thiserror::Error;

use crate::{
    jpeg::JpegError,
    limits::{MAX_COMPRESSED, MAX_SIDE},
};

/// The names in `crate::encoding`.
const SUPPORTED: &str = "rgb8, bgr8, rgba8, bgra8, mono8, 8UC1, 8UC3, 8UC4, yuv422 (uyvy), yuv422_yuy2 (yuyv), nv12, nv21, nv24, or \
     bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8";

/// A fault of an image message.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ImageError {
    /// An unsupported pixel format.
    #[error("image encoding \"{0}\" is not supported; expected {SUPPORTED}")]
    Encoding(String),
    /// Distances, or other values of more than 8 bits, which are almost black as a picture.
    #[error(
        "\"{0}\" is a depth picture, or grey of more than 8 bits, and not supported as a camera; choose the colour camera's \
         topic, or publish mono8"
    )]
    Depth(String),
    /// No pixels, or too many.
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
        /// Row step in the message \[bytes\].
        step: u32,
        /// Columns.
        width: u32,
        /// The pixel format.
        encoding: String,
        /// Size of a row \[bytes\].
        needed: usize,
    },
    /// Less data than step and height require.
    #[error("image data has {actual} bytes; step {step} x height {height} need {expected}")]
    Data {
        /// Bytes that came.
        actual: usize,
        /// Expected number of bytes.
        expected: usize,
        /// Row step \[byte\].
        step: usize,
        /// Rows.
        height: u32,
    },
    /// An unsupported codec.
    #[error(
        "compressed image is {found} (format \"{format}\"), which is not supported; expected JPEG or PNG"
    )]
    Format {
        /// The codec, by its first bytes.
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
    /// The JPEG is incomplete, damaged or has an unsupported layout.
    #[error("compressed image (jpeg): {0}")]
    Jpeg(#[from] JpegError),
    /// The codec cannot decode the data, or cannot encode.
    #[error("compressed image ({format}): {source}")]
    Codec {
        /// The codec.
        format: &'static str,
        /// The error.
        source: image::ImageError,
    },
}

impl ImageError {
    /// Whether the fault is of the format, so that all pictures of the same camera have it.
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
