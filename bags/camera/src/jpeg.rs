//! JPEG pictures.
//!
//! Decoders show what they can of a damaged picture: grey where data are missing. A robot's model takes the grey for the
//! scene, so a picture is surveyed first, and decoded only if it is complete.

mod decoder;
mod frame;
mod huffman;
mod scan;
mod survey;

use image::RgbImage;
use thiserror::Error;

use crate::limits::MAX_SIDE;
use survey::{Survey, survey};

/// Why a JPEG has no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum JpegError {
    /// Bytes are missing, at the end or before.
    #[error("the JPEG is incomplete: data are missing")]
    Incomplete,
    /// Bytes are wrong.
    #[error("the JPEG is damaged: {0}")]
    Damaged(String),
    /// A layout that is not supported.
    #[error(
        "JPEG with {0} is not supported; expected 8 bits a sample, baseline or progressive, grey or three colours"
    )]
    Layout(&'static str),
    /// No pixel, or too many.
    #[error("JPEG of {width}x{height} pixels; each side must be 1 to {MAX_SIDE}")]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The decoder failed on a picture that is complete.
    #[error("the JPEG decoder failed: {0}")]
    Decoder(String),
}

/// Decodes a JPEG.
///
/// # Errors
/// [`JpegError`]; data after the picture's end are not read.
pub fn decode(data: &[u8]) -> Result<RgbImage, JpegError> {
    let survey = survey(data)?;
    let picture = data.get(..survey.length).unwrap_or(data);
    if survey.needs_standard_tables {
        return decoder::decode(&with_standard_tables(picture), &survey);
    }
    decoder::decode(picture, &survey)
}

/// Columns and rows of a JPEG that is complete, and of a layout that [`decode`] decodes.
///
/// # Errors
/// [`JpegError`].
pub fn check(data: &[u8]) -> Result<(u32, u32), JpegError> {
    survey(data).map(|Survey { frame, .. }| (frame.width, frame.height))
}

/// The picture with the standard Huffman tables after its start marker.
fn with_standard_tables(picture: &[u8]) -> Vec<u8> {
    let (start, rest) = picture.split_at(picture.len().min(2));
    [start, &huffman::standard_segment(), rest].concat()
}

#[cfg(test)]
mod tests;
