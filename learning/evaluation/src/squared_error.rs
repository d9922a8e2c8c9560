//! Squared error over many pictures.

/// Sum of squared errors of RGB pixels, 0 to 1 per channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SquaredError {
    sum: f64,
    pixels: usize,
}

impl SquaredError {
    /// Adds a pixel's sum of squared errors over three channels.
    pub fn add_pixel(&mut self, error: f64) {
        self.sum += error;
        self.pixels += 1;
    }

    /// Adds the pixels of another.
    pub fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.pixels += other.pixels;
    }

    /// PSNR of the mean over all pixels \[dB\]; `None` without pixels.
    #[must_use]
    pub fn psnr(&self) -> Option<f64> {
        (self.pixels > 0).then(|| -10.0 * (self.sum / (3 * self.pixels) as f64).log10())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_is_over_all_pixels() {
        let mut error = SquaredError::default();
        assert_eq!(error.psnr(), None);
        error.add_pixel(0.03);
        let mut other = SquaredError::default();
        other.add_pixel(0.0);
        other.add_pixel(0.0);
        error.add(&other);
        // 0.03 over 9 channel values.
        assert!((error.psnr().unwrap() - 24.771).abs() < 1e-3);
    }
}
