//! Pictures of candidates side by side.

use image::{RgbImage, imageops};

/// Which of `horizon` steps (from 0) are shown in `columns` pictures: evenly spread, the last one always.
pub fn shown_steps(horizon: usize, columns: usize) -> Vec<usize> {
    let columns = columns.clamp(1, horizon.max(1));
    (1..=columns)
        .map(|column| (column * horizon / columns).max(1) - 1)
        .collect()
}

/// One picture of all: a row a candidate, a column a step, the candidate `best` framed in green. Rows and columns are
/// as large as the first picture; missing pictures are black.
pub fn tile(rows: &[Vec<RgbImage>], best: Option<usize>) -> RgbImage {
    const FRAME: u32 = 3;
    const GREEN: image::Rgb<u8> = image::Rgb([0, 200, 0]);
    let (width, height) = rows
        .iter()
        .flatten()
        .next()
        .map_or((1, 1), RgbImage::dimensions);
    // Without rows, the picture is one empty column.
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0).max(1);
    // Candidates and columns are a handful each, pictures at most a few hundred pixels wide.
    let mut all = RgbImage::new(width * columns as u32, height * rows.len().max(1) as u32);
    for (row, pictures) in (0_i64..).zip(rows) {
        for (column, picture) in (0_i64..).zip(pictures) {
            imageops::replace(
                &mut all,
                picture,
                column * i64::from(width),
                row * i64::from(height),
            );
        }
    }
    if let Some(best) = best.filter(|best| *best < rows.len()) {
        let (top, right) = (best as u32 * height, all.width());
        for y in top..top + height {
            for x in 0..right {
                let is_edge =
                    x < FRAME || x + FRAME >= right || y < top + FRAME || y + FRAME >= top + height;
                if is_edge && let Some(pixel) = all.get_pixel_mut_checked(x, y) {
                    *pixel = GREEN;
                }
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn the_last_step_is_always_shown() {
        assert_eq!(shown_steps(8, 4), [1, 3, 5, 7]);
        assert_eq!(shown_steps(3, 4), [0, 1, 2]);
        assert_eq!(shown_steps(5, 2), [1, 4]);
        assert_eq!(shown_steps(1, 1), [0]);
        assert_eq!(shown_steps(6, 0), [5]);
    }

    #[test]
    fn each_candidate_is_a_row_and_the_best_is_framed() {
        let shade = |value: u8| RgbImage::from_pixel(10, 8, Rgb([value; 3]));
        let all = tile(
            &[vec![shade(1), shade(2)], vec![shade(3), shade(4)]],
            Some(1),
        );
        assert_eq!(all.dimensions(), (20, 16));
        let at = |x, y| all.get_pixel(x, y).0;
        assert_eq!((at(0, 0), at(19, 7)), ([1; 3], [2; 3]));
        assert_eq!((at(5, 12), at(15, 12)), ([3; 3], [4; 3]));
        assert_eq!(
            (at(0, 8), at(19, 15), at(10, 8)),
            ([0, 200, 0], [0, 200, 0], [0, 200, 0])
        );
    }
}
