//! Peak signal-to-noise ratio and mean squared error.

use image::{GrayImage, RgbImage};

use crate::{MetricError, error::finite};

/// Largest 8-bit value: the data range.
const RANGE: f64 = 255.0;

/// Peak signal-to-noise ratio over all pixels and channels \[dB\]; infinite for equal images.
///
/// # Errors
/// [`MetricError::Size`], [`MetricError::Empty`].
pub fn psnr(image: &RgbImage, reference: &RgbImage) -> Result<f64, MetricError> {
    same_size(image.dimensions(), reference.dimensions())?;
    let squares = image
        .as_raw()
        .iter()
        .zip(reference.as_raw())
        .map(|(a, b)| square(*a, *b));
    decibel(squares.sum(), image.as_raw().len())
}

/// [`psnr`] over the pixels where `mask` is not 0 \[dB\].
///
/// # Errors
/// [`MetricError::Size`]; [`MetricError::Empty`] if the mask is empty.
pub fn masked_psnr(
    image: &RgbImage,
    reference: &RgbImage,
    mask: &GrayImage,
) -> Result<f64, MetricError> {
    same_size(image.dimensions(), reference.dimensions())?;
    same_size(image.dimensions(), mask.dimensions())?;
    let mut sum = 0.0;
    let mut count = 0;
    for ((a, b), inside) in image.pixels().zip(reference.pixels()).zip(mask.as_raw()) {
        if *inside != 0 {
            sum += a.0.iter().zip(b.0).map(|(a, b)| square(*a, b)).sum::<f64>();
            count += a.0.len();
        }
    }
    decibel(sum, count)
}

/// Mean squared error of two vectors, for example two latents \[their unit squared\].
///
/// # Errors
/// [`MetricError::Length`], [`MetricError::Empty`]; [`MetricError::NotFinite`].
pub fn mean_squared_error(a: &[f32], b: &[f32]) -> Result<f64, MetricError> {
    if a.len() != b.len() {
        return Err(MetricError::Length {
            first: a.len(),
            second: b.len(),
        });
    }
    if a.is_empty() {
        return Err(MetricError::Empty);
    }
    finite("values", a.iter().chain(b).copied().map(f64::from))?;
    let sum: f64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum();
    Ok(sum / a.len() as f64)
}

fn square(a: u8, b: u8) -> f64 {
    (f64::from(a) - f64::from(b)).powi(2)
}

fn decibel(sum: f64, count: usize) -> Result<f64, MetricError> {
    if count == 0 {
        return Err(MetricError::Empty);
    }
    Ok(10.0 * (RANGE * RANGE / (sum / count as f64)).log10())
}

pub(crate) fn same_size(first: (u32, u32), second: (u32, u32)) -> Result<(), MetricError> {
    if first == second {
        Ok(())
    } else {
        Err(MetricError::Size { first, second })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn one_level_of_error_is_48_decibel() {
        let a = RgbImage::from_pixel(4, 3, image::Rgb([10, 20, 30]));
        let b = RgbImage::from_pixel(4, 3, image::Rgb([11, 19, 31]));
        assert!((psnr(&a, &b).unwrap() - 20.0 * 255.0_f64.log10()).abs() < 1e-12);
        assert_eq!(psnr(&a, &a).unwrap(), f64::INFINITY);
    }

    #[test]
    fn mask_counts_only_its_pixels() {
        let a = RgbImage::new(2, 1);
        let mut b = a.clone();
        b.put_pixel(1, 0, image::Rgb([5, 5, 5]));
        let mask = GrayImage::from_raw(2, 1, vec![0, 7]).unwrap();
        let expected = 10.0 * (255.0_f64 * 255.0 / 25.0).log10();
        assert!((masked_psnr(&a, &b, &mask).unwrap() - expected).abs() < 1e-12);
        assert_eq!(
            masked_psnr(&a, &b, &GrayImage::new(2, 1)),
            Err(MetricError::Empty)
        );
    }

    #[test]
    fn sizes_must_agree() {
        let error = psnr(&RgbImage::new(2, 2), &RgbImage::new(2, 3)).unwrap_err();
        assert_eq!(
            error,
            MetricError::Size {
                first: (2, 2),
                second: (2, 3)
            }
        );
        assert_eq!(
            psnr(&RgbImage::new(0, 0), &RgbImage::new(0, 0)),
            Err(MetricError::Empty)
        );
        assert_eq!(
            mean_squared_error(&[1.0], &[]),
            Err(MetricError::Length {
                first: 1,
                second: 0
            })
        );
        assert_eq!(mean_squared_error(&[1.0, 0.0], &[0.0, 3.0]), Ok(5.0));
        assert!(mean_squared_error(&[1.0], &[f32::NAN]).is_err());
    }
}
