//! Decoded rollouts against the true frames (the paper, appendix C.2): PSNR and SSIM by step, of predictions, of
//! reconstructions (encoded and decoded: the ceiling), and of persistence (the last observed frame, repeated); also
//! metrics by networks ([`perception`](crate::perception)).

mod summary;

use anyhow::{Context as _, Result};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use wm_metrics::images::{psnr, ssim, ssim_luminance};

use crate::{
    CONTEXT, Subject,
    perception::{EpisodePerception, RolloutPictures},
    picture_strip::strip_of,
    settings::FidelitySettings,
};
pub use summary::summarise;

/// Cap of a picture's PSNR \[dB\]: rounding to 8 bits alone gives 58.9 dB, so pictures beyond it are equal, and an
/// infinite value would dominate a mean.
pub const PSNR_CAP_DB: f64 = 60.0;

/// Result of one episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeFidelity {
    /// By step.
    pub steps: Vec<StepFidelity>,
    /// True, predicted and reconstructed frames as a PNG in base64, if the report shows them.
    pub strip: Option<String>,
    /// Metrics by the user's networks.
    #[serde(default, skip_serializing_if = "EpisodePerception::is_empty")]
    pub perception: EpisodePerception,
}

/// One predicted step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepFidelity {
    /// The decoded prediction.
    pub predicted: Similarity,
    /// The frame itself, encoded and decoded.
    pub reconstructed: Similarity,
    /// The last observed frame.
    pub held: Similarity,
}

/// Similarity of two pictures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// PSNR \[dB\].
    pub psnr: f64,
    /// SSIM of the luminance, Gaussian window (the paper's).
    pub ssim: f64,
    /// SSIM of the colours, uniform 7x7 window (the reference's).
    pub ssim_colour: f64,
}

impl Similarity {
    fn of(picture: &RgbImage, truth: &RgbImage) -> Result<Self> {
        Ok(Self {
            psnr: psnr(picture, truth)?.min(PSNR_CAP_DB),
            ssim: ssim_luminance(picture, truth)?,
            ssim_colour: ssim(picture, truth)?,
        })
    }
}

/// Evenly spread episodes of sufficient length, at most the setting.
#[must_use]
pub fn units(subject: &Subject, settings: &FidelitySettings) -> Vec<usize> {
    let all = 0..subject.dataset.episodes().len();
    let long: Vec<usize> = all
        .filter(|episode| !subject.frames_of(*episode, 1).is_empty())
        .collect();
    crate::spread(long, settings.episodes)
}

/// Rolls out one episode; makes a strip of it if `shown`.
///
/// # Errors
/// If model and data do not fit.
pub fn measure(
    subject: &Subject,
    settings: &FidelitySettings,
    seed: u64,
    episode: usize,
    shown: bool,
) -> Result<EpisodeFidelity> {
    let frames = subject.frames_of(episode, settings.steps);
    let recording = subject.recording(episode, frames.len())?;
    let predicted = subject.decode(&subject.rollout(&recording, seed)?)?;
    let coming = recording.frames.narrow(0, CONTEXT, predicted.len())?;
    let reconstructed = subject.decode(&coming)?;
    let observed = frames.iter().take(CONTEXT);
    let observed: Vec<RgbImage> = observed
        .map(|index| subject.frame(*index))
        .collect::<Result<_>>()?;
    let held = observed.last().context("an observed frame")?;
    let truths = frames.iter().skip(CONTEXT);
    let truths: Vec<RgbImage> = truths
        .map(|index| subject.frame(*index))
        .collect::<Result<_>>()?;
    let steps = predicted.iter().zip(&reconstructed).zip(&truths);
    let steps = steps.map(|((predicted, reconstructed), truth)| {
        Ok(StepFidelity {
            predicted: Similarity::of(predicted, truth)?,
            reconstructed: Similarity::of(reconstructed, truth)?,
            held: Similarity::of(held, truth)?,
        })
    });
    let steps = steps.collect::<Result<_>>()?;
    let perception = subject.perception.measure(&RolloutPictures {
        observed: &observed,
        truth: &truths,
        predicted: &predicted,
        reconstructed: &reconstructed,
    })?;
    let rows = [&truths, &predicted, &reconstructed];
    let strip = shown.then(|| strip_of(&rows.map(Vec::as_slice)));
    Ok(EpisodeFidelity {
        steps,
        strip: strip.transpose()?,
        perception,
    })
}
