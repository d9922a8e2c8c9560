use anyhow::{Context as _, Result};
use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_dataset::Episode;
use wm_zoo::success_probe::SuccessClassifier;

use crate::{CONTEXT, Reader, Settings, Subject, readers::OWN_PROBE};

/// Success probabilities of one episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeVerdicts {
    /// Its instruction.
    pub instruction: String,
    /// Whether it succeeded.
    pub success: bool,
    /// Probabilities of each probe, the model's own first.
    pub probes: Vec<Answers>,
}

/// Probabilities of a success probe for one episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answers {
    /// Prefix of its figures.
    pub name: String,
    /// Description.
    pub about: String,
    /// On the latents of the true frames.
    pub real: f32,
    /// On a rollout from the first frames under the true actions.
    pub predicted: f32,
    /// On the latents of a successful episode's frames under another episode's instruction; `None` for a probe without
    /// instructions.
    pub mismatched: Option<f32>,
}

/// Evenly spread episodes with an outcome and an instruction known to all probes, at most the setting.
pub(super) fn units(subject: &Subject, settings: &Settings) -> Vec<usize> {
    let probes = &subject.readers.probes;
    if probes.is_empty() {
        return Vec::new();
    }
    let is_known = |text: &str| (probes.iter()).all(|probe| probe.model.instruction(text).is_ok());
    let episodes = subject.dataset.episodes().iter().enumerate();
    let judged = episodes.filter(|(index, episode)| {
        let is_long = !subject.frames_of(*index, 1).is_empty();
        let instruction = episode.instruction.as_deref();
        is_long && episode.success.is_some() && instruction.is_some_and(is_known)
    });
    let (successes, failures): (Vec<_>, Vec<_>) =
        judged.partition(|(_, episode)| episode.success == Some(true));
    let [successes, failures] =
        [successes, failures].map(|of| of.into_iter().map(|(index, _)| index).collect::<Vec<_>>());
    // Both outcomes, if possible: one alone has no accuracy.
    let most = settings.latents.judged_episodes;
    let half = most.div_ceil(2);
    let of_failures = half.max(most.saturating_sub(successes.len()));
    let failures = match failures.len() {
        0 => Vec::new(),
        _ => crate::spread(failures, of_failures),
    };
    let of_successes = most.saturating_sub(failures.len());
    let mut chosen = failures;
    if of_successes > 0 {
        chosen.extend(crate::spread(successes, of_successes));
    }
    chosen.sort_unstable();
    chosen
}

pub(super) fn measure(subject: &Subject, episode: usize, seed: u64) -> Result<EpisodeVerdicts> {
    let episodes = subject.dataset.episodes();
    let own = episodes.get(episode).context("no such episode")?;
    let (Some(text), Some(success)) = (&own.instruction, own.success) else {
        anyhow::bail!("{}: no instruction or no outcome", own.name);
    };
    let frames = subject.frames_of(episode, usize::MAX);
    let recording = subject.recording(episode, frames.len())?;
    let observed = recording.frames.narrow(0, 0, CONTEXT)?;
    let predicted = Tensor::cat(&[observed, subject.rollout(&recording, seed)?], 0)?;
    let other = other(episodes, episode).filter(|_| success);
    let probes = subject.readers.probes.iter();
    let probes = probes.map(|probe| {
        let real = probe.latents(&recording.frames)?;
        answers(probe, (&real, &probe.latents(&predicted)?), (text, other))
    });
    Ok(EpisodeVerdicts {
        instruction: text.clone(),
        success,
        probes: probes.collect::<Result<_>>()?,
    })
}

/// On true and predicted latents, under the episode's own and another instruction.
fn answers(
    probe: &Reader<SuccessClassifier>,
    (real, predicted): (&Tensor, &Tensor),
    (text, other): (&str, Option<&str>),
) -> Result<Answers> {
    let Reader {
        name, model, space, ..
    } = probe;
    let own = model.instruction(text)?;
    let other = other.filter(|_| model.reads_instructions());
    let other = other.and_then(|text| model.instruction(text).ok());
    Ok(Answers {
        name: name.clone(),
        about: match name.as_str() {
            OWN_PROBE => "success probe".to_owned(),
            _ => format!("{} success probe in {space}", model.kind()),
        },
        real: model.probability(real, &own)?,
        predicted: model.probability(predicted, &own)?,
        mismatched: other
            .map(|other| model.probability(real, &other))
            .transpose()?,
    })
}

/// The instruction of the next episode with a different one.
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
