//! Decoders of complete JPEGs.

use std::io::Cursor;

use image::RgbImage;
use jpeg_decoder::{ColorTransform, PixelFormat};
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};

use super::{
    JpegError,
    frame::{Colours, Component},
    survey::Survey,
};
use crate::limits::MAX_SIDE;

pub(super) fn decode(data: &[u8], survey: &Survey) -> Result<RgbImage, JpegError> {
    let frame = &survey.frame;
    // libjpeg repeats the colours of such narrow pictures instead of interpolating them.
    if frame.width <= 4 && frame.most_factors() == (2, 2) {
        return Err(JpegError::Layout("4:2:0 colours in less than 5 columns"));
    }
    let rgb = match is_for_zune(survey) {
        true => zune(data)?,
        false => jpeg_decoder(data, survey.colours)?,
    };
    RgbImage::from_raw(frame.width, frame.height, rgb)
        .ok_or_else(|| JpegError::Decoder("it returned a picture of another size".to_owned()))
}

/// Whether zune-jpeg, which is twice as fast, decodes this layout correctly. Compared with libjpeg-turbo, version 0.5.15 is
/// wrong by up to 255 levels for sequential pictures with several scans or less luma than chroma samples, and by up to 74
/// at the lower and right edges of subsampled pictures with partial blocks. jpeg-decoder is correct for all of them, except
/// for the layout that [`decode`] rejects.
fn is_for_zune(survey: &Survey) -> bool {
    let frame = &survey.frame;
    let (across, down) = frame.most_factors();
    let [first, rest @ ..] = frame.components.as_slice() else {
        return false;
    };
    let is_full =
        |c: &Component| (u32::from(c.factors.0), u32::from(c.factors.1)) == (across, down);
    let is_whole = frame.width.is_multiple_of(8 * across) && frame.height.is_multiple_of(8 * down);
    let is_one_scan = frame.is_progressive || survey.scans == 1;
    is_one_scan && is_full(first) && (is_whole || rest.iter().all(is_full))
}

fn zune(data: &[u8]) -> Result<Vec<u8>, JpegError> {
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(data), options);
    let decoded = decoder.decode();
    decoded.map_err(|error| JpegError::Decoder(error.to_string()))
}

fn jpeg_decoder(data: &[u8], colours: Colours) -> Result<Vec<u8>, JpegError> {
    let mut decoder = jpeg_decoder::Decoder::new(Cursor::new(data));
    decoder.set_color_transform(match colours {
        Colours::Grey => ColorTransform::Grayscale,
        Colours::Rgb => ColorTransform::RGB,
        Colours::YCbCr => ColorTransform::YCbCr,
    });
    let wrong = |error: jpeg_decoder::Error| JpegError::Decoder(error.to_string());
    let pixels = decoder.decode().map_err(wrong)?;
    match decoder.info().map(|info| info.pixel_format) {
        Some(PixelFormat::RGB24) => Ok(pixels),
        Some(PixelFormat::L8) => Ok(pixels.into_iter().flat_map(|level| [level; 3]).collect()),
        _ => Err(JpegError::Decoder(
            "it returned other than 8-bit colours".to_owned(),
        )),
    }
}
