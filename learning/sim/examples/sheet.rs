//! Writes a contact sheet: one row per episode, with frames spread over its length.
//!
//! `cargo run --release -p wm_sim --example sheet -- OUT.png [FIRST_SEED [ROWS [COLUMNS [FRAMES [FAILURES]]]]]` (FAILURES in percent)

use std::path::PathBuf;
use std::time::Instant;

use image::{RgbImage, imageops};
use wm_sim::{Episode, EpisodeOptions};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = PathBuf::from(
        arguments
            .next()
            .ok_or("expected the path of the picture to write")?,
    );
    let mut number = |default: u64| arguments.next().map_or(Ok(default), |text| text.parse());
    let (first, rows, columns, frames) = (number(0)?, number(6)?, number(7)?, number(50)?);
    let failures = number(0)? as f64 / 100.0;
    let size = wm_sim::render::IMAGE_SIZE;
    let mut sheet = RgbImage::new(size * columns as u32, size * rows as u32);
    for row in 0..rows {
        let start = Instant::now();
        let options = EpisodeOptions {
            frames: frames as usize,
            failures,
            ..EpisodeOptions::default()
        };
        let episode = Episode::generate(first + row, &options)?;
        let each = start.elapsed().as_secs_f64() * 1e3 / frames as f64;
        println!(
            "seed {}: \"{}\", success {}, {:?}, {each:.1} ms a frame",
            episode.seed, episode.instruction, episode.success, episode.failure
        );
        for column in 0..columns {
            let index = column * frames / columns;
            if let Some(frame) = episode.frames.get(index as usize) {
                imageops::replace(
                    &mut sheet,
                    &frame.image,
                    i64::from(size) * column as i64,
                    i64::from(size) * row as i64,
                );
            }
        }
    }
    sheet.save(&out)?;
    Ok(())
}
