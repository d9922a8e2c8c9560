use std::{fs, path::Path};

use image::RgbImage;
use openh264::{
    OpenH264API,
    decoder::{DecodeOptions, DecodedYUV, Decoder, DecoderConfig, Flush},
    formats::YUVSource as _,
};

use super::mp4::{H264Track, with_h264_track};
use crate::{ImportError, episode::jpeg};

/// No side of a frame may be longer.
const MAX_SIDE: usize = 8192;
/// NAL units of an elementary stream begin with this (H.264 annex B).
const START_CODE: [u8; 4] = [0, 0, 0, 1];

/// The frames of an h264 video in the order in which they are shown, as JPEG. Their times are not looked at.
pub(super) fn read(file: &Path, jpeg_quality: u8) -> Result<Vec<Vec<u8>>, ImportError> {
    let bytes = fs::read(file).map_err(|source| ImportError::io(file, source))?;
    with_h264_track(&bytes, |track| decode(&track, jpeg_quality))
        .map_err(|reason| ImportError::corrupt(file, reason))
}

fn decode(track: &H264Track, jpeg_quality: u8) -> Result<Vec<Vec<u8>>, String> {
    // Frames must come out in the order in which they are shown, so that the decoder is never made to give one early.
    let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
    let options = DecodeOptions::new().flush_after_decode(Flush::NoFlush);
    let mut decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
        .map_err(|error| format!("no h264 decoder: {error}"))?;
    let mut packet = Vec::new();
    for parameters in &track.parameters {
        packet.extend(START_CODE);
        packet.extend(*parameters);
    }
    let mut frames = Vec::with_capacity(track.samples.len());
    for (number, sample) in track.samples.iter().enumerate() {
        let at_frame = |reason: String| format!("frame {number}: {reason}");
        append_annex_b(&mut packet, sample, track.length_bytes).map_err(at_frame)?;
        let picture = decoder
            .decode_with_options(&packet, options.clone())
            .map_err(|error| at_frame(error.to_string()))?;
        if let Some(picture) = picture {
            frames.push(encode(&picture, jpeg_quality).map_err(at_frame)?);
        }
        packet.clear();
    }
    for picture in decoder
        .flush_remaining()
        .map_err(|error| error.to_string())?
    {
        frames.push(encode(&picture, jpeg_quality)?);
    }
    if frames.len() != track.samples.len() {
        return Err(format!(
            "expected {} frames, decoded {}",
            track.samples.len(),
            frames.len()
        ));
    }
    Ok(frames)
}

/// Turns the length before each NAL unit, as mp4 has it, into a start code, as the decoder wants it.
fn append_annex_b(
    packet: &mut Vec<u8>,
    mut sample: &[u8],
    length_bytes: usize,
) -> Result<(), String> {
    while !sample.is_empty() {
        let (length, rest) = sample
            .split_at_checked(length_bytes)
            .ok_or_else(|| "it ends within the length of a NAL unit".to_owned())?;
        // At most four bytes, which fit.
        let length = length
            .iter()
            .fold(0, |length: usize, byte| length << 8 | usize::from(*byte));
        let (unit, after) = rest.split_at_checked(length).ok_or_else(|| {
            format!(
                "a NAL unit claims {length} bytes where {} are left",
                rest.len()
            )
        })?;
        packet.extend(START_CODE);
        packet.extend(unit);
        sample = after;
    }
    Ok(())
}

/// A decoded picture as JPEG. Colours are taken as BT.601 in the limited range, as decoders do for a video that does
/// not say.
fn encode(picture: &DecodedYUV, quality: u8) -> Result<Vec<u8>, String> {
    let (width, height) = picture.dimensions();
    if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
        return Err(format!(
            "expected frames of 1 to {MAX_SIDE} pixels a side, got {width} x {height}"
        ));
    }
    let mut rgb = vec![0; width * height * 3];
    picture.write_rgb8(&mut rgb);
    RgbImage::from_raw(width as u32, height as u32, rgb)
        .ok_or_else(|| format!("a frame of {width} x {height} does not fit its bytes"))
        .and_then(|frame| jpeg(&frame, quality).map_err(|error| error.to_string()))
}
