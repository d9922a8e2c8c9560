use image::RgbImage;
use re_rav1d::dav1d::{
    Decoder as Rav1dDecoder, Picture, PixelLayout, PlanarImageComponent, Settings,
    pixel::{MatrixCoefficients, YUVRange},
};
use wm_camera::{
    image_message::MAX_SIDE,
    video::{ColourTags, check_size},
    yuv::{Plane, YuvTable},
};

use super::Decoder;

/// Decodes AV1 in mp4 (one temporal unit per sample, with the sequence header in keyframes).
pub(super) struct Av1Decoder {
    decoder: Rav1dDecoder,
    /// Colour tags of the container, for streams without tags.
    colours: ColourTags,
}

impl Av1Decoder {
    pub fn new(colours: ColourTags) -> Result<Self, String> {
        let mut settings = Settings::new();
        // Without delay: late frames could not be distinguished from missing ones.
        settings.set_max_frame_delay(1);
        settings.set_n_threads(1);
        // Fits 32 bits: at most MAX_SIDE^2 pixels.
        settings.set_frame_size_limit(MAX_SIDE * MAX_SIDE);
        let decoder = Rav1dDecoder::with_settings(&settings);
        Ok(Self {
            decoder: decoder.map_err(|error| format!("no AV1 decoder: {error}"))?,
            colours,
        })
    }

    /// Adds the frames that are ready.
    fn take_ready(&mut self, frames: &mut Vec<RgbImage>) -> Result<(), String> {
        loop {
            match self.decoder.get_picture() {
                Ok(picture) => frames.push(rgb(&picture, self.colours)?),
                Err(error) if error.is_again() => return Ok(()),
                Err(error) => return Err(error.to_string()),
            }
        }
    }
}

impl Decoder for Av1Decoder {
    fn feed(&mut self, sample: &[u8]) -> Result<Vec<RgbImage>, String> {
        let mut frames = Vec::new();
        let mut sent = self.decoder.send_data(sample.to_vec(), None, None, None);
        loop {
            match sent {
                Ok(()) => break,
                // The decoder accepts more data after its frames are taken.
                Err(error) if error.is_again() => {
                    let before = frames.len();
                    self.take_ready(&mut frames)?;
                    sent = self.decoder.send_pending_data();
                    if frames.len() == before && sent.is_err() {
                        return Err(
                            "the AV1 decoder neither accepts data nor returns a frame".into()
                        );
                    }
                }
                Err(error) => return Err(error.to_string()),
            }
        }
        self.take_ready(&mut frames)?;
        Ok(frames)
    }

    fn finish(&mut self) -> Result<Vec<RgbImage>, String> {
        let mut frames = Vec::new();
        self.take_ready(&mut frames)?;
        Ok(frames)
    }
}

fn rgb(picture: &Picture, container: ColourTags) -> Result<RgbImage, String> {
    let size = check_size(picture.width() as usize, picture.height() as usize);
    let size = size.map_err(|error| error.to_string())?;
    if picture.pixel_layout() != PixelLayout::I420 || picture.bit_depth() != 8 {
        return Err(format!(
            "expected 8-bit AV1 with 4:2:0 chroma (yuv420p), got {} bits and {:?}",
            picture.bit_depth(),
            picture.pixel_layout()
        ));
    }
    let planes = [
        PlanarImageComponent::Y,
        PlanarImageComponent::U,
        PlanarImageComponent::V,
    ]
    .map(|component| (picture.plane(component), picture.stride(component) as usize));
    let [y, u, v] = planes.each_ref().map(|(plane, stride)| Plane {
        data: plane,
        stride: *stride,
    });
    let tags = ColourTags {
        // 2 is unspecified.
        matrix: matrix(picture.matrix_coefficients()),
        is_full_range: Some(picture.color_range() == YUVRange::Full),
    };
    let table = YuvTable::new(tags.or(container).colours());
    table
        .rgb_of_420(size, [y, u, v])
        .map_err(|error| error.to_string())
}

/// The number of a matrix in ITU-T H.273, table 4.
fn matrix(matrix: MatrixCoefficients) -> Option<u8> {
    match matrix {
        MatrixCoefficients::BT709 => Some(1),
        MatrixCoefficients::BT470M => Some(4),
        MatrixCoefficients::BT470BG => Some(5),
        MatrixCoefficients::ST240M => Some(7),
        MatrixCoefficients::BT2020NonConstantLuminance
        | MatrixCoefficients::BT2020ConstantLuminance => Some(9),
        _ => None,
    }
}
