//! Structural similarity (Wang et al. 2004) over a uniform window, per colour channel.

use image::RgbImage;

use super::psnr::same_size;
use crate::MetricError;

/// Side of the window \[px\].
pub const SSIM_WINDOW: u32 = 7;

/// K1 = 0.01 and K2 = 0.03 of the paper, at data range 255.
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Mean structural similarity in \[-1, 1\]: colour, 7x7 uniform window, data range 255, unbiased (co)variances, over
/// all windows inside the image. Same as scikit-image's `structural_similarity(a, b, win_size=7, channel_axis=2,
/// data_range=255)`.
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

/// Sums of x, y, x^2, y^2 and xy over columns or adjacent windows. Integers up to 49 x 255^2, so adding and subtracting
/// is exact; one vector each, since such loops become vector instructions.
type Sums = [Vec<u32>; 5];

/// Mean over all windows of one channel. Running column sums make the cost independent of the window height.
fn channel_ssim(image: &[u8], reference: &[u8], width: usize, channel: usize) -> f64 {
    let of_channel = |values: &[u8]| -> Vec<u8> {
        let values = values.iter().skip(channel).step_by(CHANNELS);
        values.copied().collect()
    };
    let (xs, ys) = (of_channel(image), of_channel(reference));
    let rows: Vec<_> = xs.chunks_exact(width).zip(ys.chunks_exact(width)).collect();

    let mut columns = Sums::default().map(|_| vec![0; width]);
    let mut windows = Sums::default().map(|_| vec![0; width + 1 - WINDOW]);
    let mut similarities = vec![0.0; width + 1 - WINDOW];
    let (mut total, mut count) = (0.0, 0);
    for (index, row) in rows.iter().enumerate() {
        change(&mut columns, *row, |sum, value| sum + value);
        if let Some(gone) = index.checked_sub(WINDOW).and_then(|index| rows.get(index)) {
            change(&mut columns, *gone, |sum, value| sum - value);
        }
        if index + 1 < WINDOW {
            continue;
        }
        for (windows, columns) in windows.iter_mut().zip(&columns) {
            windows.fill(0);
            for columns in columns.windows(similarities.len()) {
                windows
                    .iter_mut()
                    .zip(columns)
                    .for_each(|(sum, column)| *sum += column);
            }
        }
        let [x, y, xx, yy, xy] = &windows;
        let sums = x.iter().zip(y).zip(xx).zip(yy).zip(xy);
        for (similarity, ((((x, y), xx), yy), xy)) in similarities.iter_mut().zip(sums) {
            *similarity = similarity_of([x, y, xx, yy, xy].map(|sum| f64::from(*sum)));
        }
        total += similarities.iter().sum::<f64>();
        count += similarities.len();
    }
    total / count as f64
}

/// Adds or subtracts a row of pixels.
fn change(columns: &mut Sums, (xs, ys): (&[u8], &[u8]), by: impl Fn(u32, u32) -> u32) {
    let [x_sums, y_sums, xx_sums, yy_sums, xy_sums] = columns;
    let sums = x_sums.iter_mut().zip(y_sums).zip(xx_sums).zip(yy_sums);
    let sums = sums.zip(xy_sums).zip(xs.iter().zip(ys));
    for (((((x_sum, y_sum), xx_sum), yy_sum), xy_sum), (x, y)) in sums {
        let (x, y) = (u32::from(*x), u32::from(*y));
        *x_sum = by(*x_sum, x);
        *y_sum = by(*y_sum, y);
        *xx_sum = by(*xx_sum, x * x);
        *yy_sum = by(*yy_sum, y * y);
        *xy_sum = by(*xy_sum, x * y);
    }
}

/// Similarity from a window's sums, which are exact in f64.
fn similarity_of(sums: [f64; 5]) -> f64 {
    let count = (WINDOW * WINDOW) as f64;
    let [mean_x, mean_y, mean_xx, mean_yy, mean_xy] = sums.map(|sum| sum / count);
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

    /// Pattern of the golden value: `(x*37 + y*59 + c*101 + x*y*s) % 256`.
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
    fn too_small_images_are_rejected() {
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
