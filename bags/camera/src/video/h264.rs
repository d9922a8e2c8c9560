//! h264 as an elementary stream (ITU-T H.264, annex B).

use h264_reader::{
    nal::{
        UnitType,
        sps::{ChromaFormat, SeqParameterSet},
    },
    rbsp::{BitReader, decode_nal},
};
use image::RgbImage;
use openh264::{
    OpenH264API,
    decoder::{DecodeOptions, DecodedYUV, Decoder, DecoderConfig, Flush},
    formats::YUVSource as _,
};

use super::{ColourTags, VideoError, check_size};
use crate::yuv::{Plane, YuvColours, YuvTable};

/// Start code of NAL units; the longer form has another 0 before it.
const START_CODE: [u8; 3] = [0, 0, 1];

/// Error flag `dsRefLost` of OpenH264's `codec_app_def.h`.
const REFERENCE_LOST: i64 = 0x02;

/// Decodes h264 with 8-bit samples, 4:2:0.
pub struct H264Decoder {
    decoder: Decoder,
    /// Colour tags of the container.
    container: ColourTags,
    colours: YuvColours,
    table: YuvTable,
}

impl std::fmt::Debug for H264Decoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("H264Decoder")
            .field("container", &self.container)
            .field("colours", &self.colours)
            .finish_non_exhaustive()
    }
}

impl H264Decoder {
    /// A decoder with the container's colour tags; as in ffmpeg, those of the stream take precedence.
    ///
    /// # Errors
    /// OpenH264 cannot start.
    pub fn new(container: ColourTags) -> Result<Self, VideoError> {
        // Without flushing, so that frames come in presentation order.
        let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|error| VideoError::Decoder(error.to_string()))?;
        let colours = ColourTags::default().or(container).colours();
        Ok(Self {
            decoder,
            container,
            colours,
            table: YuvTable::new(colours),
        })
    }

    /// Decodes NAL units with start codes; returns the pictures that are ready, in presentation order.
    ///
    /// # Errors
    /// An unsupported layout, or damaged units.
    pub fn feed(&mut self, units: &[u8]) -> Result<Vec<RgbImage>, VideoError> {
        for unit in nal_units(units) {
            if unit_type(unit) == Some(UnitType::SeqParameterSet) {
                self.parameters(unit)?;
            }
        }
        let options = DecodeOptions::new().flush_after_decode(Flush::NoFlush);
        let picture = self.decoder.decode_with_options(units, options);
        let picture = picture.map_err(|error| match error.native_code() & REFERENCE_LOST {
            0 => VideoError::Decoder(error.to_string()),
            _ => VideoError::Missing,
        })?;
        picture
            .iter()
            .map(|picture| rgb(&self.table, picture))
            .collect()
    }

    /// Returns the remaining pictures.
    pub fn finish(&mut self) -> Result<Vec<RgbImage>, VideoError> {
        let pictures = self.decoder.flush_remaining();
        let pictures = pictures.map_err(|error| VideoError::Decoder(error.to_string()))?;
        pictures
            .iter()
            .map(|picture| rgb(&self.table, picture))
            .collect()
    }

    /// Reads the colour tags of a sequence.
    fn parameters(&mut self, unit: &[u8]) -> Result<(), VideoError> {
        let damaged = || VideoError::Damaged("its sequence parameters are invalid");
        let bits = decode_nal(unit).map_err(|_| damaged())?;
        let Ok(parameters) = SeqParameterSet::from_bits(BitReader::new(&*bits)) else {
            // OpenH264 reads fewer of these parameters, so it decides whether they are valid.
            return Ok(());
        };
        let chroma = &parameters.chroma_info;
        let depths = (chroma.bit_depth_luma_minus8, chroma.bit_depth_chroma_minus8);
        if depths != (0, 0) {
            return Err(VideoError::Layout("more than 8 bits a sample"));
        }
        match chroma.chroma_format {
            ChromaFormat::YUV420 => {}
            ChromaFormat::Monochrome => return Err(VideoError::Layout("no colours (grey)")),
            _ => return Err(VideoError::Layout("chroma other than 4:2:0")),
        }
        let signal = parameters
            .vui_parameters
            .and_then(|vui| vui.video_signal_type);
        let stream = signal.map_or_else(ColourTags::default, |signal| ColourTags {
            matrix: signal
                .colour_description
                .map(|colours| colours.matrix_coefficients),
            is_full_range: Some(signal.video_full_range_flag),
        });
        let colours = stream.or(self.container).colours();
        if colours != self.colours {
            self.colours = colours;
            self.table = YuvTable::new(colours);
        }
        Ok(())
    }
}

fn rgb(table: &YuvTable, picture: &DecodedYUV<'_>) -> Result<RgbImage, VideoError> {
    let (width, height) = picture.dimensions();
    let size = check_size(width, height)?;
    let (luma, blue, red) = picture.strides();
    let planes = [
        Plane {
            data: picture.y(),
            stride: luma,
        },
        Plane {
            data: picture.u(),
            stride: blue,
        },
        Plane {
            data: picture.v(),
            stride: red,
        },
    ];
    Ok(table.rgb_of_420(size, planes)?)
}

/// The type of a NAL unit without its start code.
pub(super) fn unit_type(unit: &[u8]) -> Option<UnitType> {
    UnitType::for_id(unit.first()? & 0b1_1111).ok()
}

/// Whether the first picture of the units is a keyframe.
pub fn has_keyframe(units: &[u8]) -> bool {
    nal_units(units).any(|unit| unit_type(unit) == Some(UnitType::SliceLayerWithoutPartitioningIdr))
}

/// Whether the units have a picture.
pub(super) fn has_picture(units: &[u8]) -> bool {
    let is_slice = |unit| {
        matches!(
            unit_type(unit),
            Some(
                UnitType::SliceLayerWithoutPartitioningIdr
                    | UnitType::SliceLayerWithoutPartitioningNonIdr
                    | UnitType::SliceDataPartitionALayer
            )
        )
    };
    nal_units(units).any(is_slice)
}

/// The NAL units between start codes.
pub(super) fn nal_units(units: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = after_start_code(units);
    std::iter::from_fn(move || {
        let unit = rest?;
        let end = unit.windows(3).position(|bytes| bytes == START_CODE);
        rest = end.and_then(|end| after_start_code(unit.get(end..)?));
        let unit = unit.get(..end.unwrap_or(unit.len()))?;
        // Zeros after a unit do not belong to it: the longer start code begins with one.
        let length = unit
            .iter()
            .rposition(|byte| *byte != 0)
            .map_or(0, |at| at + 1);
        unit.get(..length)
    })
}

fn after_start_code(bytes: &[u8]) -> Option<&[u8]> {
    let at = bytes.windows(3).position(|bytes| bytes == START_CODE)?;
    bytes.get(at + 3..)
}
