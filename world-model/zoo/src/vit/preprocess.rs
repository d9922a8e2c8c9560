//! What each encoder does to a picture before its first layer.
//!
//! Pictures are (N, H, W, 3), f32 in 0..1. Facts from `docs/architecture.md#encoders`: Web-DINO and
//! SigLIP 2 resize as `torch.nn.functional.interpolate(mode="bicubic")` does, without clamping what
//! overshoots; V-JEPA 2.1 clamps to 0..1 and takes 256x256 as it is.

use candle_core::{DType, Tensor};
use rayon::prelude::*;

use super::resample::{AxisWeights, resample};
use crate::Result;
use crate::layers::host;
use crate::sizes::shape_error;

/// Pixels that one task normalises at least.
const PIXELS: usize = 16 * 1024;

/// Mean and standard deviation per colour channel that pictures are normalised with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Normalisation {
    /// Mean of red, green and blue.
    pub(crate) mean: [f32; 3],
    /// Standard deviation of red, green and blue.
    pub(crate) std: [f32; 3],
}

impl Normalisation {
    /// That of ImageNet: V-JEPA, DINO and EfficientNet.
    pub(crate) const IMAGENET: Self = Self {
        mean: [0.485, 0.456, 0.406],
        std: [0.229, 0.224, 0.225],
    };

    /// 0..1 to -1..1: SigLIP.
    pub(crate) const HALF: Self = Self {
        mean: [0.5; 3],
        std: [0.5; 3],
    };

    /// (x - mean) / std of `image` (N, H, W, 3).
    ///
    /// # Errors
    /// If the picture has not three channels.
    pub(crate) fn apply(&self, image: &Tensor) -> Result<Tensor> {
        check(image)?;
        let device = image.device();
        let image = image.to_dtype(DType::F32)?;
        if host::is_plain(&image) {
            return host::changed(&image, |values| {
                let pixels = values.as_chunks_mut::<3>().0;
                pixels
                    .par_iter_mut()
                    .with_min_len(PIXELS)
                    .for_each(|pixel| {
                        for ((value, mean), std) in pixel.iter_mut().zip(self.mean).zip(self.std) {
                            *value = (*value - mean) / std;
                        }
                    });
            });
        }
        let centred = image.broadcast_sub(&Tensor::new(&self.mean, device)?)?;
        Ok(centred.broadcast_div(&Tensor::new(&self.std, device)?)?)
    }
}

/// Resizes `image` (N, H, W, 3) to (N, size, size, 3) as PyTorch's bicubic interpolation does it
/// (a = -0.75, half-pixel centres, borders repeated, no antialiasing, no clamping); a picture of
/// that size is taken as it is.
///
/// # Errors
/// If the picture is empty or has not three channels.
pub(crate) fn resize_bicubic(image: &Tensor, size: usize) -> Result<Tensor> {
    let (h, w) = check(image)?;
    if (h, w) == (size, size) {
        return Ok(image.to_dtype(DType::F32)?);
    }
    let rows = AxisWeights::bicubic(h, size);
    let columns = AxisWeights::bicubic(w, size);
    resample(image, &rows, &columns)
}

/// Height and width of a picture (N, H, W, 3) that is not empty.
fn check(image: &Tensor) -> Result<(usize, usize)> {
    match image.dims() {
        &[n, h, w, 3] if n > 0 && h > 0 && w > 0 => Ok((h, w)),
        _ => Err(shape_error("the image", "(N, H, W, 3), not empty", image)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    #[test]
    fn normalisation_is_per_channel() {
        let image = Tensor::full(0.5_f32, (1, 1, 1, 3), &Device::Cpu).unwrap();
        let values = |n: Normalisation| {
            let normalised = n.apply(&image).unwrap().flatten_all().unwrap();
            normalised.to_vec1::<f32>().unwrap()
        };
        assert_eq!(values(Normalisation::HALF), [0.0; 3]);
        let expected = [0.015 / 0.229, 0.044 / 0.224, 0.094 / 0.225];
        for (found, expected) in values(Normalisation::IMAGENET).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn gradients_go_through_a_preprocessed_picture() {
        let picture = wm_model::random::uniform(&[1, 6, 5, 3], 1).unwrap();
        let variable = Var::from_tensor(&picture).unwrap();
        let prepare = |picture: &Tensor| {
            let resized = resize_bicubic(picture, 4).unwrap();
            Normalisation::IMAGENET.apply(&resized).unwrap()
        };
        let (plain, tracked) = (prepare(&picture), prepare(&variable));
        let difference = (plain - &tracked).unwrap().abs().unwrap();
        let most: f32 = difference.max_all().unwrap().to_scalar().unwrap();
        assert!(most < 1e-5, "they differ by {most}");
        let gradients = tracked.sum_all().unwrap().backward().unwrap();
        assert_eq!(gradients.get(&variable).unwrap().dims(), picture.dims());
    }

    #[test]
    fn a_resized_picture_may_overshoot() {
        let mut values = vec![0.0_f32; 16 * 16 * 3];
        values[..8 * 16 * 3].fill(1.0);
        let image = Tensor::from_vec(values, (1, 16, 16, 3), &Device::Cpu).unwrap();
        let resized = resize_bicubic(&image, 14).unwrap();
        let most = resized.max_all().unwrap().to_scalar::<f32>().unwrap();
        assert!(most > 1.001, "an edge was clamped: {most}");
    }

    #[test]
    fn a_picture_of_another_shape_is_named() {
        let image = Tensor::zeros((1, 4, 4, 4), DType::F32, &Device::Cpu).unwrap();
        let message = resize_bicubic(&image, 2).unwrap_err().to_string();
        assert!(message.contains("[1, 4, 4, 4]"), "{message}");
    }
}
