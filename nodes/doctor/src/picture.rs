//! Brightness and size of a camera picture.

use image::RgbImage;

/// A camera picture and its statistics.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Columns and rows \[px\].
    pub size: (u32, u32),
    /// Mean of all values, 0 black to 1 white.
    pub mean: f64,
    /// Their standard deviation, in the same unit.
    pub spread: f64,
    pub pixels: RgbImage,
}

impl Picture {
    #[must_use]
    pub fn of(pixels: RgbImage) -> Self {
        let count = pixels.as_raw().len().max(1) as f64;
        let values = || {
            pixels
                .as_raw()
                .iter()
                .map(|value| f64::from(*value) / 255.0)
        };
        let mean = values().sum::<f64>() / count;
        let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        Self {
            size: pixels.dimensions(),
            mean,
            spread: variance.sqrt(),
            pixels,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_spread_cover_all_values() {
        let mut pixels = RgbImage::new(2, 1);
        pixels.put_pixel(0, 0, image::Rgb([255; 3]));
        let picture = Picture::of(pixels);
        assert_eq!(
            (picture.size, picture.mean, picture.spread),
            ((2, 1), 0.5, 0.5)
        );
        assert_eq!(Picture::of(RgbImage::new(0, 0)).mean, 0.0);
    }
}
