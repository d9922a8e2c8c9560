//! JPEG pictures.
//!
//! Decoders show damaged pictures with grey areas, which a robot's model takes for the scene. So each picture is examined
//! first, and decoded only if it is complete.

mod decoder;
mod frame;
mod huffman;
mod scan;
mod survey;

use image::RgbImage;
use thiserror::Error;

use crate::limits::MAX_SIDE;
use survey::{Survey, survey};

/// A fault of a JPEG.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum JpegError {
    #[error("the JPEG is incomplete: data are missing")]
    Incomplete,
    #[error("the JPEG is damaged: {0}")]
    Damaged(String),
    #[error(
        "JPEG with {0} is not supported; expected 8 bits a sample, baseline or progressive, grey or three colours"
    )]
    Layout(&'static str),
    #[error("JPEG of {width}x{height} pixels; each side must be 1 to {MAX_SIDE}")]
    Size { width: u32, height: u32 },
    #[error("the JPEG decoder failed: {0}")]
    Decoder(String),
}

/// Decodes a JPEG; ignores bytes after its end.
pub fn decode(data: &[u8]) -> Result<RgbImage, JpegError> {
    let survey = survey(data)?;
    // The survey found the end within the data.
    let picture = data.get(..survey.length).unwrap_or(data);
    if survey.needs_standard_tables {
        return decoder::decode(&insert_standard_tables(picture), &survey);
    }
    decoder::decode(picture, &survey)
}

/// Checks that [`decode`] decodes a JPEG; returns its columns and rows.
pub fn check(data: &[u8]) -> Result<(u32, u32), JpegError> {
    survey(data).map(|Survey { frame, .. }| (frame.width, frame.height))
}

/// Inserts the standard Huffman tables after the start marker.
fn insert_standard_tables(picture: &[u8]) -> Vec<u8> {
    let (start, rest) = picture.split_at(picture.len().min(2));
    [start, &huffman::standard_segment(), rest].concat()
}

#[cfg(test)]
mod tests;
