//! The picture strip: real, predicted and difference over the steps of one rollout.

use super::{
    font::{CHARACTER, width, write},
    scorer::ShownRollout,
};
use image::{Rgb, RgbImage, imageops};
use wm_metrics::images::psnr;

/// The picture's file in a report.
pub(super) const STRIP: &str = "strip.png";
/// Between pictures, and around them \[px\].
const GAP: u32 = 6;
/// Smaller pictures are enlarged to this \[px\].
const LEAST_SIDE: u32 = 96;
/// The amplification of the difference: errors of a few levels would be invisible.
const DIFFERENCE_GAIN: u16 = 2;

/// Explains the rows of figures at the foot.
const LEGEND: [&str; 2] = [
    "PSNR: predicted against real",
    "held: the same for the repeated last observed frame (persistence)",
];

const BACKGROUND: Rgb<u8> = Rgb([24, 24, 28]);
const BLANK: Rgb<u8> = Rgb([40, 40, 46]);
const INK: Rgb<u8> = Rgb([230, 230, 230]);

/// Rows: real, predicted, difference. Columns: the observation and every compared step, with the PSNR of the prediction
/// and of the persistence baseline, and a legend. `period_s`: duration of a step.
#[must_use]
pub(crate) fn picture_strip(rollout: &ShownRollout, period_s: f64) -> RgbImage {
    let scale = LEAST_SIDE.div_ceil(rollout.observed.width().max(1)).max(1);
    let (cell_width, cell_height) = (
        rollout.observed.width() * scale,
        rollout.observed.height() * scale,
    );
    let difference_label = format!("|diff| x{DIFFERENCE_GAIN}");
    let rows = ["real", "predicted", difference_label.as_str()];
    // `rows` is not empty
    let left = rows.iter().map(|label| width(label)).max().unwrap_or(0) + 2 * GAP;
    let top = CHARACTER + 2 * GAP;
    let line = CHARACTER + GAP / 2;
    // a rollout has at most some 64 steps
    let columns = rollout.steps.len() as u32 + 1;
    let strip_width = left + columns * (cell_width + GAP);
    let legend: Vec<String> = LEGEND
        .iter()
        .flat_map(|text| wrapped(text, strip_width - 2 * GAP))
        .collect();
    // a legend has at most some ten lines
    let foot_lines = 2 + legend.len() as u32;
    let size = (
        strip_width,
        top + 3 * (cell_height + GAP) + foot_lines * line + 2 * GAP,
    );
    let mut strip = RgbImage::from_pixel(size.0, size.1, BACKGROUND);
    let row_top = |row: u32| top + row * (cell_height + GAP);
    for (row, label) in (0..).zip(rows) {
        write(&mut strip, label, GAP, row_top(row) + cell_height / 2, INK);
    }
    let foot = row_top(3);
    write(&mut strip, "PSNR", GAP, foot, INK);
    write(&mut strip, "held", GAP, foot + line, INK);
    for (row, text) in (2..).zip(&legend) {
        write(&mut strip, text, GAP, foot + GAP + row * line, INK);
    }

    let blank = RgbImage::from_pixel(cell_width, cell_height, BLANK);
    let mut paste = |picture: &RgbImage, x: u32, row: u32| {
        let shown = imageops::resize(
            picture,
            cell_width,
            cell_height,
            imageops::FilterType::Nearest,
        );
        imageops::replace(&mut strip, &shown, i64::from(x), i64::from(row_top(row)));
    };
    let column_left = |column: u32| left + column * (cell_width + GAP);
    paste(&rollout.observed, column_left(0), 0);
    paste(&blank, column_left(0), 1);
    paste(&blank, column_left(0), 2);
    for (column, (real, predicted)) in (1..).zip(rollout.steps.values()) {
        let x = column_left(column);
        paste(real, x, 0);
        paste(predicted, x, 1);
        paste(&difference(real, predicted), x, 2);
    }
    write(&mut strip, "observed", column_left(0), GAP, INK);
    for (column, (step, (real, predicted))) in (1..).zip(&rollout.steps) {
        let x = column_left(column);
        write(
            &mut strip,
            &format!("k={step} +{:.1}s", f64::from(*step) * period_s),
            x,
            GAP,
            INK,
        );
        for (y, picture) in [(foot, predicted), (foot + line, &rollout.observed)] {
            if let Ok(decibel) = psnr(picture, real) {
                write(&mut strip, &format!("{decibel:.1} dB"), x, y, INK);
            }
        }
    }
    strip
}

/// `text` in lines no wider than `limit` \[px\]; a wider word is a line of its own.
fn wrapped(text: &str, limit: u32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if width(line) + width(word) + CHARACTER <= limit => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// The amplified difference of every channel.
fn difference(real: &RgbImage, predicted: &RgbImage) -> RgbImage {
    let mut difference = real.clone();
    for (pixel, other) in difference.pixels_mut().zip(predicted.pixels()) {
        for (value, other) in pixel.0.iter_mut().zip(other.0) {
            let stronger = u16::from(value.abs_diff(other)) * DIFFERENCE_GAIN;
            // saturates
            *value = u8::try_from(stronger).unwrap_or(u8::MAX);
        }
    }
    difference
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn every_step_has_its_column() {
        let grey = |level| Arc::new(RgbImage::from_pixel(128, 128, Rgb([level; 3])));
        let steps = [(1, (grey(100), grey(110))), (4, (grey(120), grey(150)))].into();
        let rollout = ShownRollout {
            observed: grey(90),
            steps,
        };
        let strip = picture_strip(&rollout, 0.4);
        let left = width("predicted") + 2 * GAP;
        let top = CHARACTER + 2 * GAP;
        let centre = |column: u32, row: u32| {
            strip
                .get_pixel(
                    left + column * (128 + GAP) + 64,
                    top + row * (128 + GAP) + 64,
                )
                .0[0]
        };
        assert_eq!([centre(0, 0), centre(1, 0), centre(2, 0)], [90, 100, 120]);
        assert_eq!([centre(1, 1), centre(2, 1)], [110, 150]);
        assert_eq!([centre(1, 2), centre(2, 2)], [20, 60]);
        assert_eq!(strip.width(), left + 3 * (128 + GAP));
        // the legend is below the rows of figures
        let legend_top = top + 3 * (128 + GAP) + 2 * (CHARACTER + GAP / 2);
        let has_ink = |y| (0..strip.width()).any(|x| *strip.get_pixel(x, y) == INK);
        assert!((legend_top..strip.height()).any(has_ink));
        assert!(!(strip.height() - GAP..strip.height()).any(has_ink));
    }

    #[test]
    fn narrow_strip_wraps_its_legend() {
        assert_eq!(wrapped("one two three", 8 * 7), ["one two", "three"]);
        assert_eq!(wrapped("one two three", 8), ["one", "two", "three"]);
    }
}
