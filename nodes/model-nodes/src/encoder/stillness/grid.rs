//! A picture reduced to cells in which a camera's noise averages out.

use image::RgbImage;

/// Cells along a side at most.
const MOST_CELLS: usize = 32;
/// Pixels along a cell's side at least: the mean of 64 pixels has an eighth of their noise.
const CELL_SIDE: usize = 8;
/// The least difference of two cells that is no noise, if cells have so many pixels that noise averages out \[grey
/// level\]: rounding, and the steps in which JPEG stores the mean of a block.
const LEAST: f32 = 1.0;
/// The same for a cell of one pixel; it falls with the root of the pixels \[grey level\].
const LEAST_OF_PIXEL: f32 = 16.0;
/// Standard deviations of the cells' noise that one of a thousand cells does not exceed by chance.
const DEVIATIONS: f32 = 6.0;
/// A greater difference is no noise: where the whole picture moves, most cells differ \[grey level\].
const MOST: f32 = 8.0;
/// Standard deviation over median of the magnitude, for a normal distribution.
const OF_MEDIAN: f32 = 1.4826;

/// Mean brightness of the cells of a picture \[grey level\], row-major.
///
/// `wm_camera::signature` measures cells too, for the audit of recordings. The two stay apart, because the decisions depend on
/// the cells: here at most 32x32 of every nth pixel, since each frame of a live camera is measured, compared cell by cell with
/// the noise of so many pixels; there at most 32x24 of all pixels, compared by their mean. With the cells of the other, the
/// limits of either would no longer hold.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Grid {
    columns: usize,
    /// Least number of pixels of a cell.
    pixels: f32,
    cells: Vec<f32>,
}

/// How two pictures differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Difference {
    /// Mean difference of the cells, without those that differ by noise alone: 0 (same) to 1 (black to white).
    pub change: f32,
    /// The greatest difference of a cell over what noise explains: above 1, the picture has changed.
    pub strength: f32,
}

impl Grid {
    /// The cells of a picture. Of a large one, every nth pixel of every nth row counts.
    pub(crate) fn of(picture: &RgbImage) -> Self {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let cells = |side: usize| (side / CELL_SIDE).clamp(1, MOST_CELLS);
        let (columns, rows) = (cells(width), cells(height));
        let stride = (width.min(height) / (MOST_CELLS * CELL_SIDE)).max(1);
        let mut sums = vec![(0_u32, 0_u32); columns * rows];
        let lines = picture.as_raw().chunks_exact((3 * width).max(3));
        for (y, line) in lines.enumerate().step_by(stride) {
            let row = y * rows / height.max(1);
            for (x, pixel) in line.chunks_exact(3).enumerate().step_by(stride) {
                let cell = sums.get_mut(row * columns + x * columns / width.max(1));
                if let (Some((sum, count)), [red, green, blue]) = (cell, pixel) {
                    // The weights of ITU-R BT.601, in 256ths.
                    *sum +=
                        (77 * u32::from(*red) + 150 * u32::from(*green) + 29 * u32::from(*blue))
                            >> 8;
                    *count += 1;
                }
            }
        }
        // Cells have at most some thousand pixels.
        let mean = |(sum, count): &(u32, u32)| *sum as f32 / (*count).max(1) as f32;
        Self {
            columns,
            pixels: sums
                .iter()
                .map(|(_, count)| *count)
                .min()
                .unwrap_or(1)
                .max(1) as f32,
            cells: sums.iter().map(mean).collect(),
        }
    }

    /// How this picture differs from an earlier one. Pictures of different sizes differ wholly.
    pub(super) fn difference(&self, earlier: &Self) -> Difference {
        if (self.columns, self.cells.len()) != (earlier.columns, earlier.cells.len()) {
            return Difference {
                change: 1.0,
                strength: f32::INFINITY,
            };
        }
        let pairs = self.cells.iter().zip(&earlier.cells);
        let differences: Vec<f32> = pairs.map(|(now, before)| (now - before).abs()).collect();
        let least = LEAST + LEAST_OF_PIXEL / self.pixels.min(earlier.pixels).sqrt();
        let noise = DEVIATIONS * OF_MEDIAN * median(differences.clone());
        let limit = noise.clamp(least, MOST.max(least));
        let changed = differences.iter().filter(|difference| **difference > limit);
        let greatest = differences.iter().copied().fold(0.0, f32::max);
        Difference {
            // At most 1024 cells.
            change: changed.sum::<f32>() / (255.0 * differences.len().max(1) as f32),
            strength: greatest / limit,
        }
    }
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn cells_are_means_of_brightness_whatever_the_size() {
        for (width, height) in [(1, 1), (7, 200), (64, 64), (640, 480), (1921, 1080)] {
            let grid = Grid::of(&RgbImage::from_pixel(width, height, image::Rgb([200; 3])));
            assert!(grid.cells.len() <= MOST_CELLS * MOST_CELLS);
            assert!(
                grid.cells.iter().all(|cell| *cell == 200.0),
                "{width}x{height}"
            );
        }
    }

    #[test]
    fn black_to_white_is_one_and_another_size_too() {
        let of = |side, level| Grid::of(&RgbImage::from_pixel(side, side, image::Rgb([level; 3])));
        assert_eq!(of(64, 255).difference(&of(64, 0)).change, 1.0);
        assert_eq!(of(64, 0).difference(&of(128, 0)).change, 1.0);
        let same = of(64, 9).difference(&of(64, 9));
        assert_eq!((same.change, same.strength), (0.0, 0.0));
    }

    proptest! {
        #[test]
        fn any_size_is_taken(width in 0_u32..70, height in 0_u32..70) {
            let grid = Grid::of(&RgbImage::new(width, height));
            prop_assert!(grid.difference(&grid).strength == 0.0);
        }
    }
}
