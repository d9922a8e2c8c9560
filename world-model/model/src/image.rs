//! Camera pictures to tensors and back.

use candle_core::{DType, Device, Tensor};
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;

use crate::{Error, Result};

/// Resizes `rgb` to `size` (height, width) and scales it to 0..1: a tensor (1, H, W, 3), f32.
///
/// The filter is bilinear with antialiasing, as `torchvision` resizes; a picture that already has
/// the size is taken as it is. The aspect ratio is not kept.
///
/// # Errors
/// If the picture or the size is empty.
pub fn preprocess(rgb: &RgbImage, size: (usize, usize)) -> Result<Tensor> {
    let resized = resize(rgb, size)?;
    let (h, w) = size;
    let values = resized
        .into_raw()
        .into_iter()
        .map(|v| f32::from(v) / 255.0)
        .collect::<Vec<_>>();
    Ok(Tensor::from_vec(values, (1, h, w, 3), &Device::Cpu)?)
}

/// Resizes `rgb` to `size` (height, width), bilinear with antialiasing.
///
/// # Errors
/// If the picture or the size is empty.
pub fn resize(rgb: &RgbImage, size: (usize, usize)) -> Result<RgbImage> {
    let (h, w) = size;
    if (rgb.height() as usize, rgb.width() as usize) == size {
        return Ok(rgb.clone());
    }
    let fail = |reason: String| Error::config("image size", reason);
    let (Ok(target_h), Ok(target_w)) = (u32::try_from(h), u32::try_from(w)) else {
        return Err(fail(format!("{h}x{w} is too large")));
    };
    if rgb.width() == 0 || rgb.height() == 0 || h == 0 || w == 0 {
        return Err(fail(format!(
            "cannot resize {}x{} to {h}x{w}: both must hold at least one pixel",
            rgb.height(),
            rgb.width()
        )));
    }
    let source = TypedImageRef::<U8x3>::from_buffer(rgb.width(), rgb.height(), rgb.as_raw())
        .map_err(|e| fail(e.to_string()))?;
    let mut bytes = vec![0; h * w * 3];
    let mut target = TypedImage::<U8x3>::from_buffer(target_w, target_h, &mut bytes)
        .map_err(|e| fail(e.to_string()))?;
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    // Typed: the untyped call compiles every filter for every pixel type, a minute of build time.
    Resizer::new()
        .resize_typed(&source, &mut target, &options)
        .map_err(|e| fail(e.to_string()))?;
    RgbImage::from_raw(target_w, target_h, bytes)
        .ok_or_else(|| fail(format!("{h}x{w} does not match the resized data")))
}

/// A picture from a tensor (H, W, 3) with values in 0..1; values outside are clamped.
///
/// # Errors
/// If the tensor has another shape.
pub fn to_rgb(tensor: &Tensor) -> Result<RgbImage> {
    let shape_error = || Error::Shape {
        what: "picture",
        expected: "(H, W, 3)".to_owned(),
        found: tensor.dims().to_vec(),
    };
    let &[h, w, 3] = tensor.dims() else {
        return Err(shape_error());
    };
    let (Ok(height), Ok(width)) = (u32::try_from(h), u32::try_from(w)) else {
        return Err(shape_error());
    };
    let values = tensor
        .to_dtype(DType::F32)?
        .flatten_all()?
        .to_vec1::<f32>()?;
    // A NaN becomes 0 by the rules of `as`.
    let bytes = values
        .iter()
        .map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    RgbImage::from_raw(width, height, bytes).ok_or_else(shape_error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_picture_survives_the_round_trip() {
        let picture = RgbImage::from_fn(5, 3, |x, y| Rgb([x as u8 * 40, y as u8 * 70, 255]));
        let tensor = preprocess(&picture, (3, 5)).unwrap();
        assert_eq!(tensor.dims(), [1, 3, 5, 3]);
        assert_eq!(to_rgb(&tensor.squeeze(0).unwrap()).unwrap(), picture);
    }

    #[test]
    fn halving_averages_with_the_antialiased_triangle() {
        // One row 0, 0, 0, 0, 240, 240, 240, 240: the antialiased bilinear filter of scale 2 has
        // weights 1/8, 3/8, 3/8, 1/8, so the two pixels beside the edge get 1/8 and 7/8 of 240.
        let picture = RgbImage::from_fn(8, 2, |x, _| Rgb([if x < 4 { 0 } else { 240 }; 3]));
        let halved = resize(&picture, (1, 4)).unwrap();
        let row: Vec<u8> = halved.pixels().map(|p| p.0[0]).collect();
        assert_eq!(row, [0, 30, 210, 240]);
    }

    #[test]
    fn an_empty_target_is_refused() {
        let picture = RgbImage::new(4, 4);
        let message = preprocess(&picture, (0, 4)).unwrap_err().to_string();
        assert!(message.contains("4x4 to 0x4"), "{message}");
    }

    #[test]
    fn a_tensor_of_another_shape_is_refused() {
        let tensor = Tensor::zeros((4, 4), DType::F32, &Device::Cpu).unwrap();
        let message = to_rgb(&tensor).unwrap_err().to_string();
        assert_eq!(message, "picture has shape [4, 4], expected (H, W, 3)");
    }
}
