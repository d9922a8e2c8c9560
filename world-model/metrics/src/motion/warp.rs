use image::{Rgb, Rgb32FImage};

use super::Flow;
use crate::{MetricError, images::psnr::same_size};

/// Warps a picture by a flow: the result at (x, y) is the picture at (x + u, y + v), bilinear, clamped to the edge. The
/// flow from frame t - 1 to t and the picture at t reconstruct frame t - 1. Same as PyTorch's
/// `grid_sample(mode="bilinear", padding_mode="border", align_corners=True)`.
///
/// # Errors
/// [`MetricError::Size`]; [`MetricError::NotFinite`] for the picture.
pub fn warp(picture: &Rgb32FImage, flow: &Flow) -> Result<Rgb32FImage, MetricError> {
    same_size(picture.dimensions(), flow.dimensions())?;
    let values = picture.as_raw().iter().copied().map(f64::from);
    crate::error::finite("the picture's values", values)?;
    let (width, height) = picture.dimensions();
    let mut warped = Rgb32FImage::new(width, height);
    let pixels = warped.enumerate_pixels_mut().zip(flow.vectors());
    for ((x, y, pixel), (u, v)) in pixels {
        *pixel = sample(picture, f64::from(x) + u, f64::from(y) + v);
    }
    Ok(warped)
}

fn sample(picture: &Rgb32FImage, x: f64, y: f64) -> Rgb<f32> {
    let (columns, rows) = (between(x, picture.width()), between(y, picture.height()));
    let mut sum = [0.0; 3];
    for (row, weight_of_row) in rows {
        for (column, weight) in columns {
            let weight = weight * weight_of_row;
            let Some(pixel) = picture.get_pixel_checked(column, row) else {
                continue;
            };
            sum.iter_mut()
                .zip(pixel.0)
                .for_each(|(sum, value)| *sum += weight * f64::from(value));
        }
    }
    Rgb(sum.map(|value| value as f32))
}

/// The two neighbours of a position along a side, and their weights.
fn between(place: f64, side: u32) -> [(u32, f64); 2] {
    let last = f64::from(side.saturating_sub(1));
    let place = place.clamp(0.0, last);
    let low = place.floor();
    // Integers from 0 to the last pixel.
    let high = (low + 1.0).min(last);
    [
        (low as u32, 1.0 - (place - low)),
        (high as u32, place - low),
    ]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn warp_interpolates_and_clamps() {
        let picture = Rgb32FImage::from_fn(3, 2, |x, y| {
            Rgb([x as f32, y as f32 * 10.0, (x * y) as f32])
        });
        let u = vec![0.5, 0.25, 9.0, -9.0, 0.0, 0.0];
        let v = vec![0.0, 1.0, 0.0, -0.5, -1.0, 7.0];
        let warped = warp(&picture, &Flow::new(3, 2, u, v).unwrap()).unwrap();
        let expected = [
            [0.5, 0.0, 0.0],
            [1.25, 10.0, 1.25],
            [2.0, 0.0, 0.0],
            [0.0, 5.0, 0.0],
            [1.0, 0.0, 0.0],
            [2.0, 10.0, 2.0],
        ];
        assert!(warped.pixels().map(|pixel| pixel.0).eq(expected));
    }

    #[test]
    fn sizes_must_agree() {
        let flow = Flow::new(1, 1, vec![0.0], vec![0.0]).unwrap();
        let error = warp(&Rgb32FImage::new(2, 1), &flow).unwrap_err();
        assert!(matches!(
            error,
            MetricError::Size {
                first: (2, 1),
                second: (1, 1)
            }
        ));
    }
}
