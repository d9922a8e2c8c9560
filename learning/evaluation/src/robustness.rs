//! Predictions under a worse camera, other light or another rate (beyond the paper): the range of reliable inputs.
//!
//! A change of light or camera is permanent: it affects observed and true frames. At a wrong rate all frames are closer
//! or farther apart than the model assumes, while the actions are those of its own rate. A lost frame is lost once.

mod change;
mod summary;

use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use image::RgbImage;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use wm_metrics::images::psnr;

pub use change::Change;
pub use summary::summarise;

use crate::{CONTEXT, Settings, Subject, fidelity::PSNR_CAP_DB, squared, subject::Recording};

/// Result of one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WindowRobustness {
    /// One per change; the first is without change.
    pub changes: Vec<UnderChange>,
}

/// Predictions under one change, by step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnderChange {
    /// The change.
    pub change: Change,
    /// Squared latent error of the predictions.
    pub error: Vec<f64>,
    /// Error of the last observed latent, repeated.
    pub persistence: Vec<f64>,
    /// PSNR of the decoded predictions \[dB\]; empty without a decoder.
    pub psnr: Vec<f64>,
    /// PSNR of the last observed frame, repeated, under the same change.
    #[serde(default)]
    pub held_psnr: Vec<f64>,
}

/// Windows as (episode, first camera frame), long enough for every change.
#[must_use]
pub fn units(subject: &Subject, settings: &Settings) -> Vec<(usize, usize)> {
    let skip = subject.world.encoding.frame_skip();
    let steps = CONTEXT + settings.robustness.steps;
    let spacing = Change::ALL.into_iter().map(|change| change.spacing(skip));
    // `Change::ALL` is not empty.
    let span = (steps - 1) * spacing.max().unwrap_or(skip) + 1;
    let episodes = subject.dataset.episodes().iter().enumerate();
    let windows = episodes.flat_map(|(index, episode)| {
        let starts = (0..(episode.frame_count + 1).saturating_sub(span)).step_by(span);
        starts.map(move |start| (index, start))
    });
    crate::spread(windows.collect(), settings.robustness.windows)
}

/// Predicts one window under every change.
///
/// # Errors
/// If model and data do not fit.
pub fn measure(
    subject: &Subject,
    settings: &Settings,
    seed: u64,
    (episode, start): (usize, usize),
) -> Result<WindowRobustness> {
    let episodes = subject.dataset.episodes();
    let own = episodes.get(episode).context("no such episode")?;
    let encoding = &subject.world.encoding;
    let skip = encoding.frame_skip();
    let steps = CONTEXT + settings.robustness.steps;
    let under = |change: Change| {
        let spacing = change.spacing(skip);
        let at = |step: usize| own.first_frame + start + step * spacing;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let frames = (0..steps).map(|step| Ok(change.of(&subject.frame(at(step))?, &mut rng)));
        let mut changed: Vec<RgbImage> = frames.collect::<Result<_>>()?;
        if change == Change::Dropped
            && let [before, newest, ..] = changed.as_mut_slice()
        {
            *newest = before.clone();
        }
        let latents = subject.encode(&changed)?;
        let actions = (0..steps).map(|step| {
            // One step at the model's own rate; the last frames of an episode have no whole step.
            let first = start + step * spacing;
            let first = first.min(own.actions.len().saturating_sub(skip));
            let actions = own.actions.get(first..first + skip);
            Ok(encoding
                .encode_step(actions.context("no such action")?)?
                .values)
        });
        let actions: Vec<Vec<f32>> = actions.collect::<Result<_>>()?;
        let shape = (steps, encoding.action_dim());
        let actions = Tensor::from_vec(actions.concat(), shape, &Device::Cpu)?;
        let recording = Recording {
            frames: latents.clone(),
            actions,
        };
        let predicted = subject.rollout(&recording, seed)?;
        let held = latents.narrow(0, CONTEXT - 1, 1)?;
        let truth = |k: usize| latents.narrow(0, CONTEXT + k, 1);
        let count = predicted.dim(0)?;
        let pictures = match &subject.decoder {
            Some(_) => subject.decode(&predicted)?,
            None => Vec::new(),
        };
        let coming = changed.iter().skip(CONTEXT);
        let last = changed.get(CONTEXT - 1).context("no observed frame")?;
        let came = coming.clone().take(pictures.len());
        let held_psnr = came.map(|frame| Ok(psnr(last, frame)?.min(PSNR_CAP_DB)));
        let held_psnr = held_psnr.collect::<Result<_>>()?;
        Ok(UnderChange {
            change,
            error: (0..count)
                .map(|k| squared(&predicted.narrow(0, k, 1)?, &truth(k)?))
                .collect::<Result<_>>()?,
            persistence: (0..count)
                .map(|k| squared(&held, &truth(k)?))
                .collect::<Result<_>>()?,
            psnr: pictures
                .iter()
                .zip(coming)
                .map(|(a, b)| Ok(psnr(a, b)?.min(PSNR_CAP_DB)))
                .collect::<Result<_>>()?,
            held_psnr,
        })
    };
    let changes = Change::ALL.into_iter();
    let changes = changes.filter(|change| change.applies_to(skip)).map(under);
    Ok(WindowRobustness {
        changes: changes.collect::<Result<_>>()?,
    })
}
