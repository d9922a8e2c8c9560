use image::RgbImage;
use re_rav1d::dav1d::{
    Decoder as Rav1dDecoder, Picture, PixelLayout, PlanarImageComponent, Plane, Settings,
};

use super::{Decoder, MAX_SIDE, check_size, rgb_image};

/// Decodes AV1 as mp4 stores it (one temporal unit a sample, the sequence header in each that needs no other).
pub(super) struct Av1Decoder(Rav1dDecoder);

impl Av1Decoder {
    pub fn new() -> Result<Self, String> {
        let mut settings = Settings::new();
        // One frame in, one frame out: what comes late could not be told from what is missing.
        settings.set_max_frame_delay(1);
        settings.set_n_threads(1);
        // At most MAX_SIDE^2 pixels, which fit 32 bits.
        settings.set_frame_size_limit((MAX_SIDE * MAX_SIDE) as u32);
        let decoder = Rav1dDecoder::with_settings(&settings);
        Ok(Self(
            decoder.map_err(|error| format!("no AV1 decoder: {error}"))?,
        ))
    }

    /// The frames that are ready.
    fn ready(&mut self, frames: &mut Vec<RgbImage>) -> Result<(), String> {
        loop {
            match self.0.get_picture() {
                Ok(picture) => frames.push(rgb(&picture)?),
                Err(error) if error.is_again() => return Ok(()),
                Err(error) => return Err(error.to_string()),
            }
        }
    }
}

impl Decoder for Av1Decoder {
    fn feed(&mut self, sample: &[u8]) -> Result<Vec<RgbImage>, String> {
        let mut frames = Vec::new();
        let mut sent = self.0.send_data(sample.to_vec(), None, None, None);
        loop {
            match sent {
                Ok(()) => break,
                // It takes the rest once its frames are fetched.
                Err(error) if error.is_again() => {
                    let before = frames.len();
                    self.ready(&mut frames)?;
                    sent = self.0.send_pending_data();
                    if frames.len() == before && sent.is_err() {
                        return Err(
                            "the AV1 decoder neither accepts data nor returns a frame".into()
                        );
                    }
                }
                Err(error) => return Err(error.to_string()),
            }
        }
        self.ready(&mut frames)?;
        Ok(frames)
    }

    fn finish(&mut self) -> Result<Vec<RgbImage>, String> {
        let mut frames = Vec::new();
        self.ready(&mut frames)?;
        Ok(frames)
    }
}

fn rgb(picture: &Picture) -> Result<RgbImage, String> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    check_size(width, height)?;
    if picture.pixel_layout() != PixelLayout::I420 || picture.bit_depth() != 8 {
        return Err(format!(
            "expected 8-bit AV1 with 4:2:0 chroma (yuv420p), got {} bits and {:?}",
            picture.bit_depth(),
            picture.pixel_layout()
        ));
    }
    let [y, u, v] = [
        PlanarImageComponent::Y,
        PlanarImageComponent::U,
        PlanarImageComponent::V,
    ]
    .map(|component| (picture.plane(component), picture.stride(component) as usize));
    let mut rgb = Vec::with_capacity(width * height * 3);
    for row in 0..height {
        let (luma, blue, red) = (line(&y, row), line(&u, row / 2), line(&v, row / 2));
        let chroma = blue.iter().zip(red).flat_map(|pair| [pair, pair]);
        for (luma, (blue, red)) in luma.iter().zip(chroma).take(width) {
            rgb.extend(bt601(*luma, *blue, *red));
        }
    }
    rgb_image(width, height, rgb)
}

/// A row of a plane that has so many bytes a row.
fn line((plane, stride): &(Plane, usize), row: usize) -> &[u8] {
    let from = row * stride;
    plane.get(from..from + stride).unwrap_or_default()
}

/// ITU-R BT.601, limited range: 16 to 235 are black to white.
fn bt601(luma: u8, blue: u8, red: u8) -> [u8; 3] {
    let luma = 255.0 / 219.0 * (f32::from(luma) - 16.0);
    let (blue, red) = (f32::from(blue) - 128.0, f32::from(red) - 128.0);
    // 255 / 224 of the differences, of which green takes what the weights 0.299, 0.587 and 0.114 leave.
    let colour = [
        luma + 1.596_03 * red,
        luma - 0.391_76 * blue - 0.812_97 * red,
        luma + 2.017_23 * blue,
    ];
    // A float becomes the nearest that fits.
    colour.map(|value| value.round() as u8)
}
