use image::{ExtendedColorType, RgbImage, codecs::jpeg::JpegEncoder};

/// Encodes a frame as JPEG of this quality, 1 to 100.
///
/// # Errors
/// The frame has no pixels, or too many for JPEG.
pub(crate) fn encode_jpeg(frame: &RgbImage, quality: u8) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode(
        frame.as_raw(),
        frame.width(),
        frame.height(),
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}
