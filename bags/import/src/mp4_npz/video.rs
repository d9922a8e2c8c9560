use std::{fs, path::Path};

use image::RgbImage;
use openh264::{
    OpenH264API,
    decoder::{DecodeOptions, DecodedYUV, Decoder, DecoderConfig, Flush},
    formats::YUVSource as _,
};
use re_mp4::{Mp4, StsdBoxContent, TrackKind};

use crate::{ImportError, episode::jpeg};

/// No side of a frame may be longer.
const MAX_SIDE: usize = 8192;
/// NAL units of an elementary stream begin with this (H.264 annex B).
const START_CODE: [u8; 4] = [0, 0, 0, 1];

/// The frames of an h264 video in the order in which they are shown, as JPEG. Their times are not looked at.
pub(super) fn read(file: &Path, jpeg_quality: u8) -> Result<Vec<Vec<u8>>, ImportError> {
    let corrupt = |reason: String| ImportError::corrupt(file, reason);
    let bytes = fs::read(file).map_err(|source| ImportError::io(file, source))?;
    let mp4 =
        Mp4::read_bytes(&bytes).map_err(|error| corrupt(format!("not an mp4 video: {error}")))?;
    let track = mp4
        .tracks()
        .values()
        .find(|track| track.kind == Some(TrackKind::Video))
        .ok_or_else(|| corrupt("it has no video track".to_owned()))?;
    let StsdBoxContent::Avc1(avc) = &track.trak(&mp4).mdia.minf.stbl.stsd.contents else {
        let codec = track
            .codec_string(&mp4)
            .unwrap_or_else(|| "unknown".to_owned());
        return Err(corrupt(format!("expected h264 video, got codec {codec}")));
    };
    let length_bytes = usize::from(avc.avcc.length_size_minus_one & 3) + 1;
    let mut packet = Vec::new();
    for parameters in avc
        .avcc
        .sequence_parameter_sets
        .iter()
        .chain(&avc.avcc.picture_parameter_sets)
    {
        packet.extend(START_CODE);
        packet.extend(&parameters.bytes);
    }

    // Frames must come out in the order in which they are shown, so that the decoder is never made to give one early.
    let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
    let options = DecodeOptions::new().flush_after_decode(Flush::NoFlush);
    let mut decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
        .map_err(|error| corrupt(format!("no h264 decoder: {error}")))?;
    let mut frames = Vec::with_capacity(track.samples.len().min(bytes.len()));
    for (number, sample) in track.samples.iter().enumerate() {
        let at_sample = |reason: String| corrupt(format!("frame {number}: {reason}"));
        let data = usize::try_from(sample.offset)
            .ok()
            .zip(usize::try_from(sample.size).ok())
            .and_then(|(offset, size)| bytes.get(offset..offset.checked_add(size)?))
            .ok_or_else(|| at_sample("its bytes are not in the file".to_owned()))?;
        append_annex_b(&mut packet, data, length_bytes).map_err(at_sample)?;
        if let Some(picture) = decoder
            .decode_with_options(&packet, options.clone())
            .map_err(|error| at_sample(error.to_string()))?
        {
            frames.push(encode(&picture, jpeg_quality).map_err(at_sample)?);
        }
        packet.clear();
    }
    for picture in decoder
        .flush_remaining()
        .map_err(|error| corrupt(error.to_string()))?
    {
        frames.push(encode(&picture, jpeg_quality).map_err(corrupt)?);
    }
    if frames.len() != track.samples.len() {
        return Err(corrupt(format!(
            "expected {} frames, decoded {}",
            track.samples.len(),
            frames.len()
        )));
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
