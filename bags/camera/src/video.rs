//! Compressed video: the packets of topics, and the decoder of h264. Behind the feature `video`, since OpenH264 is built
//! from C++.

mod h264;
mod packet;
mod stream;
mod topics;

use thiserror::Error;

use crate::{
    image_message::MAX_SIDE,
    yuv::{Matrix, ShortPlane, YuvColours},
};
pub use h264::{H264Decoder, has_keyframe};
pub use packet::VideoPacket;
pub use stream::{Dropped, Shown, VideoStream};
pub use topics::VideoTopics;

/// Why a video has no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VideoError {
    /// A codec that is not decoded here.
    #[error("video in \"{0}\" is not supported; expected h264")]
    Codec(String),
    /// A layout that is not supported.
    #[error("h264 with {0} is not supported; expected 8 bits and 4:2:0 chroma (yuv420p)")]
    Layout(&'static str),
    /// Bytes are wrong.
    #[error("the h264 stream is damaged: {0}")]
    Damaged(&'static str),
    /// A frame of no size, or of one that no camera has.
    #[error("expected frames of 1 to {MAX_SIDE} pixels per side, got {width} x {height}")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A picture depends on another one whose packet did not come.
    #[error("packets are missing: a picture depends on one that did not come")]
    Missing,
    /// The decoder failed.
    #[error("h264: {0}")]
    Decoder(String),
    /// The decoder returned less than a picture.
    #[error(transparent)]
    Plane(#[from] ShortPlane),
}

/// What a stream or its container says of colours. What is missing is as in ffmpeg: BT.601, limited range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ColourTags {
    /// `matrix_coefficients` of ITU-T H.273; 2 is unspecified.
    pub matrix: Option<u8>,
    /// Whether black to white are 0 to 255.
    pub is_full_range: Option<bool>,
}

impl ColourTags {
    /// A matrix that says nothing.
    const UNSPECIFIED: u8 = 2;

    /// These, and those of `other` where these say nothing.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        let said = |matrix: Option<u8>| matrix.filter(|matrix| *matrix != Self::UNSPECIFIED);
        Self {
            matrix: said(self.matrix).or(said(other.matrix)),
            is_full_range: self.is_full_range.or(other.is_full_range),
        }
    }

    /// The colours.
    pub fn colours(self) -> YuvColours {
        YuvColours {
            matrix: self.matrix.map_or_else(Matrix::default, Matrix::of),
            is_full_range: self.is_full_range.unwrap_or(false),
        }
    }
}

/// A size that a camera may have.
///
/// # Errors
/// [`VideoError::Size`].
pub fn checked_size(width: usize, height: usize) -> Result<(u32, u32), VideoError> {
    let side = |side: usize| {
        u32::try_from(side)
            .ok()
            .filter(|s| (1..=MAX_SIDE).contains(s))
    };
    side(width)
        .zip(side(height))
        .ok_or(VideoError::Size { width, height })
}

#[cfg(test)]
mod tests;
