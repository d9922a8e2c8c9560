use anyhow::{Result, ensure};
use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_motion::actions::Kind;
use wm_zoo::idm::TrainedIdm;

use crate::{ActionChange, Reader, Settings, Subject, Windows};

/// The actions of one window, and what the inverse dynamics models tell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToldActions {
    /// Names and kinds of the dimensions.
    pub dimensions: Vec<(String, Kind)>,
    /// One for each model.
    pub models: Vec<Told>,
}

/// What one inverse dynamics model tells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// What the names of its figures begin with.
    pub name: String,
    /// Steps k that it tells at once.
    pub k: usize,
    /// Name of the latent space that it reads.
    pub space: String,
    /// The true actions, a row each.
    pub truth: Vec<Vec<f32>>,
    /// What it tells from the latents of the frames that came.
    pub real: Vec<Vec<f32>>,
    /// What it tells from the last observed frame and the predicted ones.
    pub predicted: Vec<Vec<f32>>,
}

/// Windows that are long enough for all models; `None` where there is no model.
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

pub(super) fn measure(subject: &Subject, windows: &Windows, unit: usize) -> Result<ToldActions> {
    let model = &subject.world.transition;
    let last = windows.last_observed(unit)?;
    let real = Tensor::cat(&[&last, &windows.coming(unit)?], 0)?;
    let mut frames = vec![last];
    frames.extend(windows.predict(unit, model, subject.sampler(), ActionChange::None)?);
    let predicted = Tensor::cat(&frames, 0)?;
    let values = subject.world.encoding.space().len();
    let actions = windows.actions(unit)?.narrow(1, 0, values)?;
    let models = subject.readers.idms.iter().map(|idm| {
        let k = idm.model.idm().horizon();
        // Chunks that follow one another, so that no action counts twice.
        let starts = || (0..=predicted.dim(0).unwrap_or(0).saturating_sub(k + 1)).step_by(k);
        let mut truth = Vec::new();
        for first in starts() {
            truth.extend(actions.narrow(0, first, k)?.to_vec2::<f32>()?);
        }
        Ok(Told {
            name: idm.name.clone(),
            k,
            space: idm.space.clone(),
            truth,
            real: told(idm, &real, starts(), values)?,
            predicted: told(idm, &predicted, starts(), values)?,
        })
    });
    let space = subject.world.encoding.space();
    let dimensions = space.dimensions().iter();
    Ok(ToldActions {
        dimensions: dimensions.map(|d| (d.name.clone(), d.kind)).collect(),
        models: models.collect::<Result<_>>()?,
    })
}

fn told(
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
        let told = idm.model.actions(&latents)?.squeeze(0)?;
        rows.extend(told.narrow(1, 0, values)?.to_vec2::<f32>()?);
    }
    Ok(rows)
}
