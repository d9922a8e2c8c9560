use image::RgbImage;
use wm_camera::video::{ColourTags, H264Decoder as StreamDecoder};

use super::Decoder;

/// Start code of NAL units in an elementary stream (H.264 annex B).
const START_CODE: [u8; 4] = [0, 0, 0, 1];

pub(super) struct H264Decoder {
    decoder: StreamDecoder,
    /// Size of the length before each NAL unit \[bytes\].
    length_bytes: usize,
    /// The next input of the decoder; at first, the parameters.
    packet: Vec<u8>,
}

impl H264Decoder {
    pub fn new(
        length_bytes: usize,
        parameters: &[Vec<u8>],
        colours: ColourTags,
    ) -> Result<Self, String> {
        let decoder = StreamDecoder::new(colours).map_err(|error| error.to_string())?;
        let mut packet = Vec::new();
        for unit in parameters {
            packet.extend(START_CODE);
            packet.extend(unit);
        }
        Ok(Self {
            decoder,
            length_bytes,
            packet,
        })
    }
}

impl Decoder for H264Decoder {
    fn feed(&mut self, sample: &[u8]) -> Result<Vec<RgbImage>, String> {
        append_annex_b(&mut self.packet, sample, self.length_bytes)?;
        let pictures = self.decoder.feed(&self.packet);
        self.packet.clear();
        pictures.map_err(|error| error.to_string())
    }

    fn finish(&mut self) -> Result<Vec<RgbImage>, String> {
        self.decoder.finish().map_err(|error| error.to_string())
    }
}

/// Replaces the length before each NAL unit by a start code.
fn append_annex_b(
    packet: &mut Vec<u8>,
    mut sample: &[u8],
    length_bytes: usize,
) -> Result<(), String> {
    while !sample.is_empty() {
        let (length, rest) = sample
            .split_at_checked(length_bytes)
            .ok_or_else(|| "it ends within the length of a NAL unit".to_owned())?;
        // Fits: at most four bytes.
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
