//! Camera pictures to tensors and back.

use candle_core::{DType, Tensor};
use fast_image_resize::images::{TypedCroppedImage, TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use image::{RgbImage, imageops};

use crate::framing::{Fit, Framing, Part};
use crate::{Error, Result};

/// `rgb` as an encoder of this framing takes it, scaled to 0..1: a tensor (1, H, W, 3), f32.
///
/// The filter is bilinear with antialiasing, as `torchvision` resizes; a picture that already has
/// the size is taken as it is.
///
/// # Errors
/// If the picture or the size is empty.
pub fn preprocess(rgb: &RgbImage, framing: impl Into<Framing>) -> Result<Tensor> {
    framing.into().tensor(rgb)
}

/// Resizes `rgb` to `size` (height, width), bilinear with antialiasing. The aspect ratio is not kept;
/// [`Framing::apply`] keeps it.
///
/// # Errors
/// If the picture or the size is empty.
pub fn resize(rgb: &RgbImage, size: (usize, usize)) -> Result<RgbImage> {
    Framing::new(size, Fit::Stretch).apply(rgb)
}

/// A part of `rgb`, resized to `width` x `height`. No pixel beside the part has a share in it.
pub(crate) fn resize_part(
    rgb: &RgbImage,
    part: Part,
    (width, height): (u32, u32),
) -> Result<RgbImage> {
    if (part.width, part.height) == (width, height) {
        if (width, height) == rgb.dimensions() {
            return Ok(rgb.clone());
        }
        return Ok(imageops::crop_imm(rgb, part.x, part.y, width, height).to_image());
    }
    let fail = |reason: String| Error::config("image size", reason);
    let whole = TypedImageRef::<U8x3>::from_buffer(rgb.width(), rgb.height(), rgb.as_raw())
        .map_err(|e| fail(e.to_string()))?;
    let Part {
        x,
        y,
        width: columns,
        height: rows,
    } = part;
    // A view and not the resizer's own crop, whose filter reads pixels beside the part.
    let source = TypedCroppedImage::from_ref(&whole, x, y, columns, rows)
        .map_err(|e| fail(e.to_string()))?;
    let mut bytes = vec![0; height as usize * width as usize * 3];
    let mut target = TypedImage::<U8x3>::from_buffer(width, height, &mut bytes)
        .map_err(|e| fail(e.to_string()))?;
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    // Typed: the untyped call compiles every filter for every pixel type, a minute of build time.
    Resizer::new()
        .resize_typed(&source, &mut target, &options)
        .map_err(|e| fail(e.to_string()))?;
    RgbImage::from_raw(width, height, bytes)
        .ok_or_else(|| fail(format!("{height}x{width} does not match the resized data")))
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
    use candle_core::Device;
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
