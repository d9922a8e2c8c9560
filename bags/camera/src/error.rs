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
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ImageError {
    #[error("image encoding \"{0}\" is not supported; expected {SUPPORTED}")]
    Encoding(String),
    /// Distances, or other values of more than 8 bits, which are almost black as a picture.
    #[error(
        "\"{0}\" is a depth picture, or grey of more than 8 bits, and not supported as a camera; choose the colour camera's \
         topic, or publish mono8"
    )]
    Depth(String),
    #[error("image of {width}x{height} pixels; each side must be 1 to {MAX_SIDE}")]
    Size { width: u32, height: u32 },
    #[error("image step is {step} bytes; {width} pixels of {encoding} need at least {needed}")]
    Step {
        /// Row step in the message \[bytes\].
        step: u32,
        width: u32,
        encoding: String,
        /// Size of a row \[bytes\].
        needed: usize,
    },
    #[error("image data has {actual} bytes; step {step} x height {height} need {expected}")]
    Data {
        actual: usize,
        expected: usize,
        /// Row step \[byte\].
        step: usize,
        height: u32,
    },
    #[error(
        "compressed image is {found} (format \"{format}\"), which is not supported; expected JPEG or PNG"
    )]
    Format { found: &'static str, format: String },
    #[error("compressed image has {actual} bytes; expected at most {MAX_COMPRESSED}")]
    TooLarge { actual: usize },
    #[error("compressed image (jpeg): {0}")]
    Jpeg(#[from] JpegError),
    #[error("compressed image ({format}): {source}")]
    Codec {
        format: &'static str,
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
