//! Structural similarity (Wang et al. 2004) over a uniform window, per colour channel.

use image::RgbImage;

use super::psnr::same_size;
use crate::MetricError;

/// Side of the window \[px\].
pub const SSIM_WINDOW: u32 = 7;

/// The constants of the paper, K1 = 0.01 and K2 = 0.03, at data range 255.
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Mean structural similarity in \[-1, 1\]: colour, 7x7 uniform window, data range 255, unbiased (co)variances, over
/// every window that lies inside the image. The same settings, and the same figure, as scikit-image's
/// `structural_similarity(a, b, win_size=7, channel_axis=2, data_range=255)`.
///
/// # Errors
/// [`MetricError::Size`]; [`MetricError::TooSmall`] below 7x7.
pub fn ssim(image: &RgbImage, reference: &RgbImage) -> Result<f64, MetricError> {
    same_size(image.dimensions(), reference.dimensions())?;
    let (width, height) = image.dimensions();
    if width < SSIM_WINDOW || height < SSIM_WINDOW {
        return Err(MetricError::TooSmall {
            size: (width, height),
            window: SSIM_WINDOW,
        });
    }
    let sum: f64 = (0..CHANNELS)
        .map(|channel| channel_ssim(image.as_raw(), reference.as_raw(), width as usize, channel))
        .sum();
    Ok(sum / CHANNELS as f64)
}

const CHANNELS: usize = 3;
const WINDOW: usize = SSIM_WINDOW as usize;

/// Sums over a window: x, y, x^2, y^2, xy. Whole numbers, so that adding and taking away leaves no rounding.
type Sums = [u64; 5];

fn add(total: &mut Sums, other: &Sums) {
    total
        .iter_mut()
        .zip(other)
        .for_each(|(total, value)| *total += value);
}

fn subtract(total: &mut Sums, other: &Sums) {
    total
        .iter_mut()
        .zip(other)
        .for_each(|(total, value)| *total -= value);
}

/// One channel's mean over all windows; rows come and go from running column sums, so that a pixel costs the same at
/// any window size.
fn channel_ssim(image: &[u8], reference: &[u8], width: usize, channel: usize) -> f64 {
    let products = |a: &u8, b: &u8| -> Sums {
        let (x, y) = (u64::from(*a), u64::from(*b));
        [x, y, x * x, y * y, x * y]
    };
    let row_of = |a: &[u8], b: &[u8]| -> Vec<Sums> {
        let values = a.iter().skip(channel).step_by(CHANNELS);
        values
            .zip(b.iter().skip(channel).step_by(CHANNELS))
            .map(|(a, b)| products(a, b))
            .collect()
    };
    let stride = width * CHANNELS;
    let rows: Vec<Vec<Sums>> = image
        .chunks_exact(stride)
        .zip(reference.chunks_exact(stride))
        .map(|(a, b)| row_of(a, b))
        .collect();

    let mut columns = vec![Sums::default(); width];
    let (mut total, mut windows) = (0.0, 0_u64);
    for (index, row) in rows.iter().enumerate() {
        columns
            .iter_mut()
            .zip(row)
            .for_each(|(column, value)| add(column, value));
        if let Some(gone) = index.checked_sub(WINDOW).and_then(|index| rows.get(index)) {
            columns
                .iter_mut()
                .zip(gone)
                .for_each(|(column, value)| subtract(column, value));
        }
        if index + 1 < WINDOW {
            continue;
        }
        for window in columns.windows(WINDOW) {
            let mut sums = Sums::default();
            window.iter().for_each(|column| add(&mut sums, column));
            total += similarity(&sums);
            windows += 1;
        }
    }
    // Window counts stay far below 2^52.
    total / windows as f64
}

fn similarity(sums: &Sums) -> f64 {
    let count = (WINDOW * WINDOW) as f64;
    // At most 49 x 255^2: exact in f64.
    let [mean_x, mean_y, mean_xx, mean_yy, mean_xy] = sums.map(|sum| sum as f64 / count);
    let unbiased = count / (count - 1.0);
    let variance_x = unbiased * (mean_xx - mean_x * mean_x);
    let variance_y = unbiased * (mean_yy - mean_y * mean_y);
    let covariance = unbiased * (mean_xy - mean_x * mean_y);
    ((2.0 * mean_x * mean_y + C1) * (2.0 * covariance + C2))
        / ((mean_x * mean_x + mean_y * mean_y + C1) * (variance_x + variance_y + C2))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// The pattern of the golden value: `(x*37 + y*59 + c*101 + x*y*s) % 256`.
    fn pattern(width: u32, height: u32, s: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([0, 1, 2].map(|c| ((x * 37 + y * 59 + c * 101 + x * y * s) % 256) as u8))
        })
    }

    #[test]
    fn equals_scikit_image() {
        // scikit-image 0.26.0, structural_similarity(a, b, win_size=7, channel_axis=2, data_range=255) on these patterns.
        let golden = [
            (7, 7, 0.843_032_574_219_466_8),
            (40, 23, -0.035_167_171_023_257_01),
            (256, 128, 0.002_462_950_875_831_697),
        ];
        for (width, height, golden) in golden {
            let value = ssim(&pattern(width, height, 3), &pattern(width, height, 4)).unwrap();
            assert!(
                (value - golden).abs() < 1e-9,
                "{width}x{height}: {value} against {golden}"
            );
        }
    }

    #[test]
    fn equal_images_are_one() {
        let image = pattern(16, 9, 1);
        assert!((ssim(&image, &image).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn too_small_is_named() {
        let image = RgbImage::new(6, 20);
        assert_eq!(
            ssim(&image, &image),
            Err(MetricError::TooSmall {
                size: (6, 20),
                window: 7
            })
        );
    }
}
