//! Camera pictures to tensors and back.

use candle_core::{DType, Tensor};
use image::RgbImage;

use crate::framing::{Fit, Framing};
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
