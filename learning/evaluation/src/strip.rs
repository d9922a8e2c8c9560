//! A picture of a rollout: true and predicted frames.

use anyhow::{Context as _, Result};
use candle_core::Tensor;
use image::RgbImage;
use wm_dataset::Dataset;
use wm_model::{Decoder, image::to_rgb, transition::LoadedTransition};

use crate::{ActionChange, CONTEXT, Windows, grid};

/// Windows shown, one below the other.
const WINDOWS: usize = 3;

/// Two rows per window: the last observed and the true frames, then the predictions.
///
/// # Errors
/// If model, decoder and dataset do not fit.
pub fn strip(
    windows: &Windows,
    model: &LoadedTransition,
    decoder: &dyn Decoder,
    dataset: &Dataset,
) -> Result<RgbImage> {
    let (height, width) = dataset.size();
    let (height, width) = (height as u32, width as u32);
    let shown: Vec<usize> = (0..WINDOWS.min(windows.len()))
        .map(|i| (2 * i + 1) * windows.len() / (2 * WINDOWS))
        .collect();
    let mut rows: Vec<Vec<Option<RgbImage>>> = Vec::new();
    for window in shown {
        let frames = windows.frame_indices(window)?;
        let real = frames.iter().skip(CONTEXT - 1).map(|index| {
            let frame = dataset.frame(*index);
            let frame = frame.with_context(|| format!("no frame {index}"))?;
            let picture = RgbImage::from_raw(width, height, frame.to_vec());
            Ok(Some(picture.context("a frame of another size")?))
        });
        rows.push(real.collect::<Result<_>>()?);
        let sampler = &model.config().sampler;
        let predicted = windows.predict(window, model, sampler, ActionChange::None)?;
        let predicted = predicted.iter().map(|latent| {
            let picture: Tensor = decoder.decode(latent)?.squeeze(0)?;
            Ok(Some(to_rgb(&picture)?))
        });
        let mut row = vec![None];
        row.extend(predicted.collect::<Result<Vec<_>>>()?);
        rows.push(row);
    }
    Ok(grid(&rows))
}
