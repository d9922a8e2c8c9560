//! The strip of an episode: camera, imagined outcome and goal.

use image::{Rgb, RgbImage, imageops};

use super::Shots;
use crate::report::font::{CHARACTER, width, write};

/// The most columns.
const COLUMNS: usize = 8;
/// Side of a picture \[px\].
const SIDE: u32 = 128;
/// Between and around pictures \[px\].
const GAP: u32 = 6;

const BACKGROUND: Rgb<u8> = Rgb([24, 24, 28]);
const INK: Rgb<u8> = Rgb([230, 230, 230]);
const ROWS: [&str; 3] = ["seen", "imagined", "goal"];

/// Rows: the camera's picture, the imagined outcome of the current plan, the goal. Columns: times of the episode.
/// `None` without pictures.
pub(crate) fn strip(shots: &Shots, goal: Option<&RgbImage>, title: &str) -> Option<RgbImage> {
    let shown = shots.evenly(COLUMNS);
    if shown.is_empty() {
        return None;
    }
    // `ROWS` is not empty
    let left = ROWS.iter().map(|row| width(row)).max().unwrap_or(0) + 2 * GAP;
    let top = 2 * CHARACTER + 3 * GAP;
    // at most COLUMNS
    let columns = shown.len() as u32;
    let size = (left + columns * (SIDE + GAP), top + 3 * (SIDE + GAP));
    let mut strip = RgbImage::from_pixel(size.0, size.1, BACKGROUND);
    write(&mut strip, title, GAP, GAP, INK);
    let row_top = |row: u32| top + row * (SIDE + GAP);
    for (row, label) in (0..).zip(ROWS) {
        write(&mut strip, label, GAP, row_top(row) + SIDE / 2, INK);
    }
    for (column, shot) in (0..).zip(shown) {
        let x = left + column * (SIDE + GAP);
        let time = format!("{:.1} s", shot.time_s);
        write(&mut strip, &time, x, CHARACTER + 2 * GAP, INK);
        let pictures = [Some(&shot.seen), shot.imagined.as_deref(), goal];
        for (row, picture) in (0..).zip(pictures) {
            if let Some(picture) = picture {
                let small = imageops::resize(picture, SIDE, SIDE, imageops::FilterType::Triangle);
                imageops::replace(&mut strip, &small, i64::from(x), i64::from(row_top(row)));
            }
        }
    }
    Some(strip)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_its_picture() {
        let grey = |level| RgbImage::from_pixel(4, 4, Rgb([level; 3]));
        let mut shots = Shots::default();
        shots.take(0, || Some(grey(100)), None);
        shots.take(200_000_000, || Some(grey(110)), Some(&grey(120).into()));
        let strip = strip(&shots, Some(&grey(130)), "reach").unwrap();
        let left = width("imagined") + 2 * GAP;
        let top = 2 * CHARACTER + 3 * GAP;
        let centre = |column: u32, row: u32| {
            let at = |index: u32| index * (SIDE + GAP) + SIDE / 2;
            strip.get_pixel(left + at(column), top + at(row)).0[0]
        };
        assert_eq!([centre(0, 0), centre(0, 2)], [100, 130]);
        assert_eq!(centre(0, 1), BACKGROUND.0[0], "nothing was imagined yet");
        assert_eq!([centre(1, 0), centre(1, 1), centre(1, 2)], [110, 120, 130]);
        assert!(super::strip(&Shots::default(), None, "").is_none());
    }
}
