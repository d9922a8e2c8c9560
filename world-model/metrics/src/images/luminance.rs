//! Structural similarity as Wang et al. 2004 define it: luminance under a Gaussian window.

use image::RgbImage;

use super::psnr::same_size;
use crate::MetricError;

/// Side of the window \[px\].
pub const SSIM_LUMINANCE_WINDOW: u32 = 11;

/// Standard deviation of the window \[px\].
const SIGMA: f64 = 1.5;
/// Rec. 601 shares of red, green and blue in luminance.
const LUMA: [f64; 3] = [0.299, 0.587, 0.114];
/// K1 = 0.01 and K2 = 0.03 of the paper, at data range 255.
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

const WINDOW: usize = SSIM_LUMINANCE_WINDOW as usize;

/// Mean structural similarity in \[-1, 1\] of the luminance (Rec. 601, not rounded): 11x11 Gaussian window of standard
/// deviation 1.5, data range 255, population (co)variances, over all windows inside the image. Same as scikit-image's
/// `structural_similarity(a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=255)` on the
/// luminance as floats.
///
/// The window is separable: 2 x 11 multiplications per pixel instead of 121, for each of five moments.
///
/// # Errors
/// [`MetricError::Size`]; [`MetricError::TooSmall`] below 11x11.
pub fn ssim_luminance(image: &RgbImage, reference: &RgbImage) -> Result<f64, MetricError> {
    same_size(image.dimensions(), reference.dimensions())?;
    let (width, height) = image.dimensions();
    if width < SSIM_LUMINANCE_WINDOW || height < SSIM_LUMINANCE_WINDOW {
        return Err(MetricError::TooSmall {
            size: (width, height),
            window: SSIM_LUMINANCE_WINDOW,
        });
    }
    let weights = weights();
    let (x, y) = (luma(image), luma(reference));
    let width = width as usize;
    let rows: Vec<Vec<Moments>> = x
        .chunks_exact(width)
        .zip(y.chunks_exact(width))
        .map(|(x, y)| across(x, y, &weights))
        .collect();
    let (mut total, mut windows) = (0.0, 0_u64);
    for rows in rows.windows(WINDOW) {
        let mut sums = vec![Moments::default(); width + 1 - WINDOW];
        for (row, weight) in rows.iter().zip(&weights) {
            sums.iter_mut()
                .zip(row)
                .for_each(|(sum, moments)| add(sum, moments, *weight));
        }
        total += sums.iter().map(similarity).sum::<f64>();
        windows += sums.len() as u64;
    }
    Ok(total / windows as f64)
}

/// Weighted means of x, y, x^2, y^2 and xy.
type Moments = [f64; 5];

fn add(sum: &mut Moments, moments: &Moments, weight: f64) {
    sum.iter_mut()
        .zip(moments)
        .for_each(|(sum, moment)| *sum += weight * moment);
}

/// The window along one side, of sum 1.
fn weights() -> [f64; WINDOW] {
    let middle = (WINDOW / 2) as f64;
    let unscaled: [f64; WINDOW] =
        std::array::from_fn(|index| (-0.5 * ((index as f64 - middle) / SIGMA).powi(2)).exp());
    let sum: f64 = unscaled.iter().sum();
    unscaled.map(|weight| weight / sum)
}

fn luma(image: &RgbImage) -> Vec<f64> {
    let of = |pixel: &image::Rgb<u8>| {
        let channels = pixel.0.iter().zip(LUMA);
        channels
            .map(|(value, share)| f64::from(*value) * share)
            .sum()
    };
    image.pixels().map(of).collect()
}

/// Moments of all windows along one row.
fn across(x: &[f64], y: &[f64], weights: &[f64; WINDOW]) -> Vec<Moments> {
    let pairs: Vec<Moments> = x
        .iter()
        .zip(y)
        .map(|(x, y)| [*x, *y, x * x, y * y, x * y])
        .collect();
    let window = |window: &[Moments]| {
        let mut sum = Moments::default();
        for (moments, weight) in window.iter().zip(weights) {
            add(&mut sum, moments, *weight);
        }
        sum
    };
    pairs.windows(WINDOW).map(window).collect()
}

fn similarity(moments: &Moments) -> f64 {
    let [x, y, xx, yy, xy] = *moments;
    let (variances, covariance) = (xx - x * x + yy - y * y, xy - x * y);
    ((2.0 * x * y + C1) * (2.0 * covariance + C2)) / ((x * x + y * y + C1) * (variances + C2))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn flat_pictures_differ_only_by_their_means() {
        let grey = |level| RgbImage::from_pixel(13, 11, image::Rgb([level; 3]));
        let expected = (2.0 * 100.0 * 50.0 + C1) / (100.0 * 100.0 + 50.0 * 50.0 + C1);
        let found = ssim_luminance(&grey(100), &grey(50)).unwrap();
        assert!((found - expected).abs() < 1e-9, "{found}");
        assert!((ssim_luminance(&grey(7), &grey(7)).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn too_small_images_are_rejected() {
        let image = RgbImage::new(11, 10);
        let expected = MetricError::TooSmall {
            size: (11, 10),
            window: 11,
        };
        assert_eq!(ssim_luminance(&image, &image), Err(expected));
    }
}
