//! Rows of pictures as one picture.

use std::io::Cursor;

use anyhow::Result;
use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::{ImageFormat, Rgb, RgbImage, imageops};

/// Gap between pictures \[px\].
const GAP: u32 = 2;
const BACKGROUND: Rgb<u8> = Rgb([24, 24, 28]);
/// Most pictures of a row.
const COLUMNS: usize = 8;
/// Greatest height of a picture \[px\].
const HEIGHT: u32 = 128;

/// Rows of pictures of one size; `None` shows the background.
#[must_use]
pub fn grid(rows: &[Vec<Option<RgbImage>>]) -> RgbImage {
    let mut pictures = rows.iter().flatten().flatten();
    let (width, height) = pictures.next().map_or((1, 1), RgbImage::dimensions);
    // Without rows the picture has one pixel.
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let size = |count: u32, side: u32| (count * (side + GAP)).saturating_sub(GAP).max(1);
    let (across, down) = (size(columns, width), size(rows.len() as u32, height));
    let mut picture = RgbImage::from_pixel(across, down, BACKGROUND);
    for (row, y) in rows.iter().zip((0..).step_by((height + GAP) as usize)) {
        for (part, x) in row.iter().zip((0..).step_by((width + GAP) as usize)) {
            if let Some(part) = part {
                imageops::replace(&mut picture, part, x, y);
            }
        }
    }
    picture
}

/// Evenly spaced pictures of each row, including first and last, as a PNG in base64.
///
/// # Errors
/// If encoding fails.
pub(crate) fn strip_of(rows: &[&[RgbImage]]) -> Result<String> {
    // Without rows the picture has one pixel.
    let longest = rows.iter().map(|row| row.len()).max().unwrap_or(0);
    let shown = COLUMNS.min(longest);
    let at = |column: usize| column * (longest - 1) / (shown - 1).max(1);
    let rows: Vec<Vec<Option<RgbImage>>> = rows
        .iter()
        .map(|row| (0..shown).map(|i| row.get(at(i)).map(small)).collect())
        .collect();
    png(&grid(&rows))
}

/// A PNG in base64.
///
/// # Errors
/// If encoding fails.
pub(crate) fn png(picture: &RgbImage) -> Result<String> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(STANDARD.encode(bytes.into_inner()))
}

fn small(picture: &RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    if height <= HEIGHT {
        return picture.clone();
    }
    let width = (width * HEIGHT / height).max(1);
    imageops::resize(picture, width, HEIGHT, imageops::FilterType::Triangle)
}
