use anyhow::{Context as _, Result};
use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_dataset::Episode;

use crate::{CONTEXT, Settings, Subject};

/// What the success probe says of one episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Its instruction.
    pub instruction: String,
    /// Whether it was carried out.
    pub success: bool,
    /// Probability on the latents of the frames.
    pub real: f32,
    /// Probability on a rollout from the first frames under the true actions.
    pub predicted: f32,
    /// Probability on the latents of the frames under another episode's instruction, of a success.
    pub mismatched: Option<f32>,
}

/// Episodes with an instruction that the probe knows and an outcome, at most so many, spread over all.
pub(super) fn units(subject: &Subject, settings: &Settings) -> Vec<usize> {
    let Some(probe) = &subject.probe else {
        return Vec::new();
    };
    let episodes = subject.dataset.episodes().iter().enumerate();
    let judged = episodes.filter(|(index, episode)| {
        let is_long = !subject.frames_of(*index, 1).is_empty();
        let instruction = episode.instruction.as_deref();
        is_long
            && episode.success.is_some()
            && instruction.is_some_and(|text| probe.instruction(text).is_ok())
    });
    let judged = judged.map(|(index, _)| index).collect();
    crate::spread(judged, settings.latents.judged_episodes)
}

pub(super) fn measure(subject: &Subject, episode: usize, seed: u64) -> Result<Judged> {
    let probe = subject.probe.as_ref().context("no success probe")?;
    let episodes = subject.dataset.episodes();
    let own = episodes.get(episode).context("no such episode")?;
    let (Some(text), Some(success)) = (&own.instruction, own.success) else {
        anyhow::bail!("{}: no instruction or no outcome", own.name);
    };
    let frames = subject.frames_of(episode, usize::MAX);
    let recording = subject.recording(episode, frames.len())?;
    let observed = recording.frames.narrow(0, 0, CONTEXT)?;
    let predicted = Tensor::cat(&[observed, subject.rollout(&recording, seed)?], 0)?;
    let instruction = probe.instruction(text)?;
    let other = other(episodes, episode).filter(|_| success);
    let other = other.and_then(|text| probe.instruction(text).ok());
    Ok(Judged {
        instruction: text.clone(),
        success,
        real: probe.probability(&recording.frames, &instruction)?,
        predicted: probe.probability(&predicted, &instruction)?,
        mismatched: other
            .map(|other| probe.probability(&recording.frames, &other))
            .transpose()?,
    })
}

/// The instruction of the next episode that has another one.
fn other(episodes: &[Episode], episode: usize) -> Option<&str> {
    let own = episodes.get(episode)?.instruction.as_deref()?;
    let after = episodes
        .iter()
        .cycle()
        .skip(episode + 1)
        .take(episodes.len());
    let mut others = after.filter_map(|other| other.instruction.as_deref());
    others.find(|other| *other != own)
}
