use anyhow::Result;
use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::{ActionChange, Subject, Windows, squared};

/// Predictions of one window under right and wrong actions: squared latent errors, and squared changes between frames,
/// by step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// Error of repeating the last observed latent.
    pub persistence: Vec<f64>,
    /// Error of the predictions under the true actions.
    pub told: Vec<f64>,
    /// Error under wrong actions, for the changes that apply.
    pub wrong: Vec<(ActionChange, Vec<f64>)>,
    /// Squared change of the true latents.
    pub motion: Vec<f64>,
    /// Squared change of the predictions under the true actions.
    pub predicted_motion: Vec<f64>,
}

pub(super) fn measure(subject: &Subject, windows: &Windows, unit: usize) -> Result<Response> {
    let last = windows.last_observed(unit)?;
    let coming = windows.coming(unit)?;
    let truths: Vec<Tensor> = (0..coming.dim(0)?)
        .map(|k| coming.narrow(0, k, 1))
        .collect::<candle_core::Result<_>>()?;
    let errors = |predicted: &[Tensor]| -> Result<Vec<f64>> {
        let pairs = predicted.iter().zip(&truths);
        pairs.map(|(a, b)| squared(a, b)).collect()
    };
    let motion = |frames: &[Tensor]| -> Result<Vec<f64>> {
        let before = std::iter::once(&last).chain(frames);
        before.zip(frames).map(|(a, b)| squared(a, b)).collect()
    };
    let predict =
        |change| windows.predict(unit, &subject.world.transition, subject.sampler(), change);
    let predicted = predict(ActionChange::None)?;
    let space = subject.world.encoding.space();
    let wrong = ActionChange::WRONG
        .into_iter()
        .filter(|change| windows.can_change(unit, *change, space));
    let wrong = wrong.map(|change| Ok((change, errors(&predict(change)?)?)));
    let held = vec![last.clone(); truths.len()];
    Ok(Response {
        persistence: errors(&held)?,
        told: errors(&predicted)?,
        wrong: wrong.collect::<Result<_>>()?,
        motion: motion(&truths)?,
        predicted_motion: motion(&predicted)?,
    })
}
