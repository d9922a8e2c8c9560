//! The strip of an episode: camera, imagined outcome, farthest subgoal and goal.

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
const SEEN: &str = "seen";
const IMAGINED: &str = "imagined";
const SUBGOAL: &str = "subgoal";
const GOAL: &str = "goal";

/// Rows: the camera's picture, the imagined outcome of the current plan, its farthest subgoal if it has subgoals, the goal.
/// Columns: times of the episode.
/// `None` without pictures.
pub(crate) fn strip(shots: &Shots, goal: Option<&RgbImage>, title: &str) -> Option<RgbImage> {
    let shown = shots.evenly(COLUMNS);
    if shown.is_empty() {
        return None;
    }
    let has_subgoals = shown.iter().any(|shot| shot.imagined.subgoals.is_some());
    let rows: &[&str] = match has_subgoals {
        true => &[SEEN, IMAGINED, SUBGOAL, GOAL],
        false => &[SEEN, IMAGINED, GOAL],
    };
    // `rows` is not empty
    let left = rows.iter().map(|row| width(row)).max().unwrap_or(0) + 2 * GAP;
    let top = 2 * CHARACTER + 3 * GAP;
    // at most COLUMNS
    let columns = shown.len() as u32;
    let size = (
        left + columns * (SIDE + GAP),
        // four at most
        top + rows.len() as u32 * (SIDE + GAP),
    );
    let mut strip = RgbImage::from_pixel(size.0, size.1, BACKGROUND);
    write(&mut strip, title, GAP, GAP, INK);
    let row_top = |row: u32| top + row * (SIDE + GAP);
    for (row, label) in (0..).zip(rows) {
        write(&mut strip, label, GAP, row_top(row) + SIDE / 2, INK);
    }
    for (column, shot) in (0..).zip(shown) {
        let x = left + column * (SIDE + GAP);
        let time = format!("{:.1} s", shot.time_s);
        write(&mut strip, &time, x, CHARACTER + 2 * GAP, INK);
        let farthest = shot.imagined.subgoals.as_deref();
        let farthest = farthest.map(|subgoals| last_of(subgoals, &shot.seen));
        for (row, label) in (0..).zip(rows) {
            let picture = match *label {
                SEEN => Some(&shot.seen),
                IMAGINED => shot.imagined.outcome.as_deref(),
                SUBGOAL => farthest.as_ref(),
                _ => goal,
            };
            if let Some(picture) = picture {
                let small = imageops::resize(picture, SIDE, SIDE, imageops::FilterType::Triangle);
                imageops::replace(&mut strip, &small, i64::from(x), i64::from(row_top(row)));
            }
        }
    }
    Some(strip)
}

/// The last of pictures side by side, each of the aspect of `seen`.
fn last_of(pictures: &RgbImage, seen: &RgbImage) -> RgbImage {
    let (columns, rows) = pictures.dimensions();
    let own = rows * seen.width() / seen.height().max(1);
    let own = own.clamp(1, columns.max(1));
    imageops::crop_imm(pictures, columns - own.min(columns), 0, own, rows).to_image()
}

#[cfg(test)]
mod tests {
    use super::super::Imagined;
    use super::*;

    #[test]
    fn every_row_has_its_picture() {
        let grey = |level| RgbImage::from_pixel(4, 4, Rgb([level; 3]));
        let mut shots = Shots::default();
        shots.take(0, || Some(grey(100)), &Imagined::default());
        let imagined = Imagined {
            outcome: Some(grey(120).into()),
            subgoals: None,
        };
        shots.take(200_000_000, || Some(grey(110)), &imagined);
        let strip = strip(&shots, Some(&grey(130)), "reach").unwrap();
        let left = width(IMAGINED) + 2 * GAP;
        let top = 2 * CHARACTER + 3 * GAP;
        let centre = |column: u32, row: u32| {
            let at = |index: u32| index * (SIDE + GAP) + SIDE / 2;
            strip.get_pixel(left + at(column), top + at(row)).0[0]
        };
        assert_eq!([centre(0, 0), centre(0, 2)], [100, 130]);
        assert_eq!(centre(0, 1), BACKGROUND.0[0], "nothing was imagined yet");
        assert_eq!([centre(1, 0), centre(1, 1), centre(1, 2)], [110, 120, 130]);
        assert!(super::strip(&Shots::default(), None, "").is_none());
        // With subgoals side by side, the farthest is shown.
        let mut both = RgbImage::from_pixel(8, 4, Rgb([140; 3]));
        imageops::replace(&mut both, &grey(150), 4, 0);
        let imagined = Imagined {
            subgoals: Some(both.into()),
            ..imagined
        };
        shots.take(400_000_000, || Some(grey(115)), &imagined);
        let strip = super::strip(&shots, Some(&grey(130)), "reach").unwrap();
        let centre = |column: u32, row: u32| {
            let at = |index: u32| index * (SIDE + GAP) + SIDE / 2;
            strip.get_pixel(left + at(column), top + at(row)).0[0]
        };
        assert_eq!([centre(2, 1), centre(2, 2), centre(2, 3)], [120, 150, 130]);
        assert_eq!(centre(1, 2), BACKGROUND.0[0]);
    }
}
