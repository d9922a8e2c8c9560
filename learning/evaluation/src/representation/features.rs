//! Features of the inverse dynamics models over whole episodes, for the paper's action trajectories (figures 2 and 10).

use anyhow::Result;
use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_zoo::idm::TrainedIdm;

use crate::{CONTEXT, Reader, Settings, Subject};

/// Features of one episode, by inverse dynamics model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeFeatures {
    /// By model.
    pub models: Vec<IdmFeatures>,
}

/// Features of one model, a row for each action from the last observed frame to the episode's end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdmFeatures {
    /// Prefix of its figures.
    pub name: String,
    /// The true actions.
    pub actions: Vec<Vec<f32>>,
    /// From the latents of the true frames.
    pub real: Vec<Vec<f32>>,
    /// From a rollout under the true actions.
    pub predicted: Vec<Vec<f32>>,
}

/// Evenly spread episodes, at most the setting; none without an inverse dynamics model.
pub(super) fn units(subject: &Subject, settings: &Settings) -> Vec<usize> {
    if subject.readers.idms.is_empty() {
        return Vec::new();
    }
    let episodes = 0..subject.dataset.episodes().len();
    let long: Vec<usize> = episodes
        .filter(|episode| !subject.frames_of(*episode, 1).is_empty())
        .collect();
    match long.is_empty() {
        true => long,
        false => crate::spread(long, settings.latents.trajectories),
    }
}

pub(super) fn measure(subject: &Subject, episode: usize, seed: u64) -> Result<EpisodeFeatures> {
    let frames = subject.frames_of(episode, usize::MAX);
    let recording = subject.recording(episode, frames.len())?;
    let steps = frames.len() - CONTEXT;
    let last = recording.frames.narrow(0, CONTEXT - 1, 1)?;
    let real = recording.frames.narrow(0, CONTEXT - 1, steps + 1)?;
    let predicted = Tensor::cat(&[last, subject.rollout(&recording, seed)?], 0)?;
    let values = subject.world.encoding.space().len();
    let actions = recording.actions.narrow(0, CONTEXT - 1, steps)?;
    let actions = actions.narrow(1, 0, values)?.to_vec2::<f32>()?;
    let models = subject.readers.idms.iter().map(|idm| {
        let k = idm.model.idm().horizon();
        Ok(IdmFeatures {
            name: idm.name.clone(),
            // As many as whole chunks of k actions have.
            actions: actions.iter().take(steps / k * k).cloned().collect(),
            real: features(idm, &real, k)?,
            predicted: features(idm, &predicted, k)?,
        })
    });
    Ok(EpisodeFeatures {
        models: models.collect::<Result<_>>()?,
    })
}

/// Features of consecutive chunks of k actions.
fn features(idm: &Reader<TrainedIdm>, frames: &Tensor, k: usize) -> Result<Vec<Vec<f32>>> {
    let frames = idm.latents(frames)?;
    let mut rows = Vec::new();
    for first in (0..frames.dim(0)?.saturating_sub(k)).step_by(k) {
        let latents = frames.narrow(0, first, k + 1)?.unsqueeze(0)?;
        rows.extend(
            idm.model
                .idm()
                .features(&latents)?
                .squeeze(0)?
                .to_vec2::<f32>()?,
        );
    }
    Ok(rows)
}
