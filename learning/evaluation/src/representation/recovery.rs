use anyhow::{Result, ensure};
use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_motion::actions::Kind;
use wm_zoo::idm::TrainedIdm;

use crate::{ActionChange, Reader, Settings, Subject, Windows, squared};

/// Actions of one window, true and inferred.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InferredActions {
    /// Names and kinds of the dimensions.
    pub dimensions: Vec<(String, Kind)>,
    /// Squared change of the latent from the last observed frame to the last true one.
    pub change: f64,
    /// By model.
    pub models: Vec<IdmActions>,
}

/// Actions inferred by one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdmActions {
    /// Prefix of its figures.
    pub name: String,
    /// Steps k inferred at once.
    pub k: usize,
    /// Name of its latent space.
    pub space: String,
    /// The true actions, a row each.
    pub truth: Vec<Vec<f32>>,
    /// Actions inferred from the latents of the true frames.
    pub real: Vec<Vec<f32>>,
    /// Actions inferred from the last observed frame and the predictions.
    pub predicted: Vec<Vec<f32>>,
    /// Those inferred from predictions under wrong actions, for the changes that apply.
    pub wrong: Vec<(ActionChange, Vec<Vec<f32>>)>,
}

/// Latents that actions are inferred from.
#[derive(Clone, Copy)]
pub(super) enum Source {
    /// Those of the true frames.
    Frames,
    /// The predictions under these actions.
    Predictions(ActionChange),
}

impl IdmActions {
    /// The actions inferred from these latents; `None` if the change does not apply.
    pub(super) fn inferred(&self, from: Source) -> Option<&Vec<Vec<f32>>> {
        match from {
            Source::Frames => Some(&self.real),
            Source::Predictions(ActionChange::None) => Some(&self.predicted),
            Source::Predictions(change) => {
                let mut wrong = self.wrong.iter();
                wrong.find(|(own, _)| *own == change).map(|(_, rows)| rows)
            }
        }
    }
}

/// The wrong actions of the control. Zero ones have no correlation.
pub(super) const WRONG: [ActionChange; 2] = [ActionChange::Negated, ActionChange::Shuffled];

/// Windows of sufficient length for all models; `None` without a model.
pub(super) fn windows(subject: &Subject, settings: &Settings) -> Result<Option<Windows>> {
    let idms = &subject.readers.idms;
    let horizons = idms.iter().map(|idm| idm.model.idm().horizon());
    let Some(longest) = horizons.max() else {
        return Ok(None);
    };
    for idm in idms {
        let (own, others) = (
            idm.model.encoding().frame_skip(),
            subject.world.encoding.frame_skip(),
        );
        ensure!(
            own == others,
            "the inverse dynamics model steps over {own} frames, the transition model over {others}"
        );
    }
    let own = &settings.latents;
    let encoding = &subject.world.encoding;
    Windows::new(
        &subject.latents,
        encoding,
        own.steps.max(longest),
        own.windows,
    )
    .map(Some)
}

pub(super) fn measure(
    subject: &Subject,
    windows: &Windows,
    unit: usize,
) -> Result<InferredActions> {
    let model = &subject.world.transition;
    let last = windows.last_observed(unit)?;
    let real = Tensor::cat(&[&last, &windows.coming(unit)?], 0)?;
    let predict = |change| -> Result<Tensor> {
        let mut frames = vec![last.clone()];
        frames.extend(windows.predict(unit, model, subject.sampler(), change)?);
        Ok(Tensor::cat(&frames, 0)?)
    };
    let predicted = predict(ActionChange::None)?;
    let space = subject.world.encoding.space();
    let wrong = WRONG
        .into_iter()
        .filter(|change| windows.can_change(unit, *change, space))
        .map(|change| Ok((change, predict(change)?)))
        .collect::<Result<Vec<_>>>()?;
    let values = space.len();
    let actions = windows.actions(unit)?.narrow(1, 0, values)?;
    let models = subject.readers.idms.iter().map(|idm| {
        let k = idm.model.idm().horizon();
        // Consecutive chunks, so that no action counts twice.
        let last = predicted.dim(0)?.saturating_sub(k + 1);
        let starts = || (0..=last).step_by(k);
        let mut truth = Vec::new();
        for first in starts() {
            truth.extend(actions.narrow(0, first, k)?.to_vec2::<f32>()?);
        }
        let wrong = wrong.iter().map(|(change, frames)| {
            let inferred = infer(idm, frames, starts(), values)?;
            Ok((*change, inferred))
        });
        Ok(IdmActions {
            wrong: wrong.collect::<Result<_>>()?,
            name: idm.name.clone(),
            k,
            space: idm.space.clone(),
            truth,
            real: infer(idm, &real, starts(), values)?,
            predicted: infer(idm, &predicted, starts(), values)?,
        })
    });
    let dimensions = space.dimensions().iter();
    Ok(InferredActions {
        change: squared(&last, &real.narrow(0, real.dim(0)? - 1, 1)?)?,
        dimensions: dimensions.map(|d| (d.name.clone(), d.kind)).collect(),
        models: models.collect::<Result<_>>()?,
    })
}

fn infer(
    idm: &Reader<TrainedIdm>,
    frames: &Tensor,
    starts: impl Iterator<Item = usize>,
    values: usize,
) -> Result<Vec<Vec<f32>>> {
    let k = idm.model.idm().horizon();
    let frames = idm.latents(frames)?;
    let mut rows = Vec::new();
    for first in starts {
        let latents = frames.narrow(0, first, k + 1)?.unsqueeze(0)?;
        let infer = idm.model.actions(&latents)?.squeeze(0)?;
        rows.extend(infer.narrow(1, 0, values)?.to_vec2::<f32>()?);
    }
    Ok(rows)
}
