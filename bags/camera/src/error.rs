//! Why an image message is refused.

use thiserror::Error;

use crate::{
    jpeg::JpegError,
    limits::{MAX_COMPRESSED, MAX_SIDE},
};

/// The encodings of `crate::encoding`, in words.
const SUPPORTED: &str = "rgb8, bgr8, rgba8, bgra8, mono8, 8UC1, 8UC3, 8UC4, yuv422 (uyvy), yuv422_yuy2 (yuyv), nv12, nv21, nv24, or \
     bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8";

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
