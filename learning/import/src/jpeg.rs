use image::{ExtendedColorType, RgbImage, codecs::jpeg::JpegEncoder};

/// A frame as JPEG of this quality, 1 to 100.
///
/// # Errors
/// The frame has no pixels, or more than JPEG can hold.
pub fn jpeg(frame: &RgbImage, quality: u8) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode(
        frame.as_raw(),
        frame.width(),
        frame.height(),
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}
