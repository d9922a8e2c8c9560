//! Compact signatures of pictures, to measure their difference.

use image::RgbImage;

const COLUMNS: u32 = 32;
const ROWS: u32 = 24;
/// Minimum side of a cell \[px\], so that noise averages out.
const LEAST_SIDE: u32 = 8;

/// The mean luma in each cell of a grid over a picture: at most 32x24 cells of at least 8x8 pixels.
///
/// The mean reduces sensor noise: at 320x240 pixels, noise of one level changes a signature by 0.1 levels, a moving arm by
/// 1 to 30.
#[derive(Clone, Debug, PartialEq)]
pub struct Signature {
    size: (u32, u32),
    cells: Vec<f32>,
}

impl Signature {
    /// Measures a picture.
    #[must_use]
    pub fn of(picture: &RgbImage) -> Self {
        let (width, height) = picture.dimensions();
        let cells = |side: u32, most: u32| (side / LEAST_SIDE).clamp(side.min(1), most);
        let (columns, rows) = (cells(width, COLUMNS), cells(height, ROWS));
        let mut sums = vec![0_u64; (columns * rows) as usize];
        let mut counts = vec![0_u64; sums.len()];
        let column_of: Vec<u32> = (0..width).map(|x| cell(x, width, columns)).collect();
        let row_bytes = (width as usize * 3).max(1);
        for (y, pixels) in (0_u32..).zip(picture.as_raw().chunks_exact(row_bytes)) {
            let first = (cell(y, height, rows) * columns) as usize;
            let (pixels, _) = pixels.as_chunks::<3>();
            for ([red, green, blue], column) in pixels.iter().zip(&column_of) {
                let at = first + *column as usize;
                // Weights of BT.601 times 256.
                let luma = 77 * u64::from(*red) + 150 * u64::from(*green) + 29 * u64::from(*blue);
                if let (Some(sum), Some(count)) = (sums.get_mut(at), counts.get_mut(at)) {
                    *sum += luma;
                    *count += 1;
                }
            }
        }
        let means = sums.iter().zip(&counts);
        let means = means.map(|(sum, count)| *sum as f32 / (256 * (*count).max(1)) as f32);
        Self {
            size: (width, height),
            cells: means.collect(),
        }
    }

    /// Width and height of the picture \[px\].
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Mean absolute difference of the cells \[levels, 0 to 255\]; `None` for different sizes.
    #[must_use]
    pub fn change(&self, other: &Self) -> Option<f32> {
        if self.size != other.size || self.cells.is_empty() {
            return None;
        }
        let pairs = self.cells.iter().zip(&other.cells);
        let sum: f64 = pairs.map(|(a, b)| f64::from((a - b).abs())).sum();
        Some((sum / self.cells.len() as f64) as f32)
    }
}

/// The cell of pixel `at`, if `cells` cells divide `length` evenly.
fn cell(at: u32, length: u32, cells: u32) -> u32 {
    // Fits: below 2^37.
    (u64::from(at) * u64::from(cells) / u64::from(length.max(1))) as u32
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use image::Rgb;
    use proptest::prelude::*;

    fn square_at(x: u32) -> RgbImage {
        RgbImage::from_fn(64, 48, |column, row| {
            let is_inside = (x..x + 12).contains(&column) && (20..32).contains(&row);
            Rgb([if is_inside { 250 } else { 60 }; 3])
        })
    }

    #[test]
    fn moved_pictures_differ_and_equal_ones_do_not() {
        let (here, there) = (Signature::of(&square_at(8)), Signature::of(&square_at(10)));
        assert_eq!(here.change(&Signature::of(&square_at(8))), Some(0.0));
        assert_eq!(here, Signature::of(&square_at(8)));
        let change = here.change(&there).unwrap();
        // 2 of 64 columns change on both edges, in 12 of 48 rows, by 190 levels.
        assert!(
            (change - 190.0 * 4.0 / 64.0 * 12.0 / 48.0).abs() < 0.1,
            "{change}"
        );
    }

    #[test]
    fn white_and_black_are_255_levels_apart() {
        let white = Signature::of(&RgbImage::from_pixel(100, 70, Rgb([255; 3])));
        let black = Signature::of(&RgbImage::new(100, 70));
        let change = white.change(&black).unwrap();
        assert!((change - 255.0).abs() < 1e-3, "{change}");
    }

    #[test]
    fn pictures_of_different_sizes_are_not_compared() {
        let wide = Signature::of(&RgbImage::new(64, 48));
        let high = Signature::of(&RgbImage::new(48, 64));
        assert_eq!((wide.change(&high), wide.size()), (None, (64, 48)));
        let none = Signature::of(&RgbImage::new(0, 0));
        assert_eq!(none.change(&none.clone()), None);
    }

    proptest! {
        #[test]
        fn any_size_gives_finite_cells(width in 1_u32..80, height in 1_u32..80, level in 0_u8..=255) {
            let picture = RgbImage::from_pixel(width, height, Rgb([level; 3]));
            let signature = Signature::of(&picture);
            for cell in &signature.cells {
                prop_assert!((cell - f32::from(level)).abs() < 0.01, "{cell} for {level}");
            }
        }
    }
}
