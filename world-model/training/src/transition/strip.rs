//! A rollout as a picture: what came, and what was predicted.

use anyhow::{Context as _, Result};
use candle_core::Tensor;
use image::{Rgb, RgbImage, imageops};
use wm_model::{Decoder, image::to_rgb, transition::PackedTransition};

use super::{ActionChange, Evaluation, evaluation::CONTEXT};
use crate::dataset::Dataset;

/// Windows that are shown, one below the other.
const WINDOWS: usize = 3;
/// Between two pictures \[px\].
const GAP: u32 = 2;
const BACKGROUND: Rgb<u8> = Rgb([24, 24, 28]);

/// Two rows for each of some windows: the last observed frame and those that came, then their predictions.
///
/// # Errors
/// If model, decoder and dataset do not fit.
pub fn strip(
    evaluation: &Evaluation,
    model: &PackedTransition,
    decoder: &dyn Decoder,
    dataset: &Dataset,
) -> Result<RgbImage> {
    let (height, width) = dataset.size();
    let (height, width) = (height as u32, width as u32);
    let shown: Vec<usize> = (0..WINDOWS.min(evaluation.len()))
        .map(|i| (2 * i + 1) * evaluation.len() / (2 * WINDOWS))
        .collect();
    let mut rows: Vec<Vec<Option<RgbImage>>> = Vec::new();
    for window in shown {
        let frames = evaluation.frame_indices(window)?;
        let real = frames.iter().skip(CONTEXT - 1).map(|index| {
            let frame = dataset.frame(*index);
            let frame = frame.with_context(|| format!("no frame {index}"))?;
            let picture = RgbImage::from_raw(width, height, frame.to_vec());
            Ok(Some(picture.context("a frame of another size")?))
        });
        rows.push(real.collect::<Result<_>>()?);
        let sampler = &model.config().sampler;
        let predicted = evaluation.predict(window, model, sampler, ActionChange::None)?;
        let predicted = predicted.iter().map(|latent| {
            let picture: Tensor = decoder.decode(latent)?.squeeze(0)?;
            Ok(Some(to_rgb(&picture)?))
        });
        let mut row = vec![None];
        row.extend(predicted.collect::<Result<Vec<_>>>()?);
        rows.push(row);
    }
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
    Ok(picture)
}
