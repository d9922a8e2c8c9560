//! Compressed video: packets of topics, and the h264 decoder. Needs the feature `video`, since OpenH264 is C++.

mod h264;
mod packet;
mod stream;
mod topics;

use thiserror::Error;

use crate::{
    limits::MAX_SIDE,
    yuv::{Matrix, ShortPlane, YuvColours},
};
pub use h264::{H264Decoder, has_keyframe};
pub use packet::VideoPacket;
pub use stream::{DropCounts, VideoPicture, VideoStream};
pub use topics::VideoTopics;

/// A fault of a video.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VideoError {
    #[error("video in \"{0}\" is not supported; expected h264")]
    Codec(String),
    #[error("h264 with {0} is not supported; expected 8 bits and 4:2:0 chroma (yuv420p)")]
    Layout(&'static str),
    #[error("the h264 stream is damaged: {0}")]
    Damaged(&'static str),
    #[error("expected frames of 1 to {MAX_SIDE} pixels per side, got {width} x {height}")]
    Size { width: usize, height: usize },
    #[error("packets are missing: a picture depends on one that was not received")]
    Missing,
    #[error("h264: {0}")]
    Decoder(String),
    /// The decoder returned an incomplete picture.
    #[error(transparent)]
    Plane(#[from] ShortPlane),
}

/// Colour tags of a stream or its container. As in ffmpeg, the defaults are BT.601 and limited range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ColourTags {
    /// `matrix_coefficients` of ITU-T H.273; 2 is unspecified.
    pub matrix: Option<u8>,
    /// Whether black to white is 0 to 255.
    pub is_full_range: Option<bool>,
}

impl ColourTags {
    const UNSPECIFIED: u8 = 2;

    /// These tags, completed by those of `other`.
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

/// Checks that a camera may have this size.
///
/// # Errors
/// [`VideoError::Size`].
pub fn check_size(width: usize, height: usize) -> Result<(u32, u32), VideoError> {
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
