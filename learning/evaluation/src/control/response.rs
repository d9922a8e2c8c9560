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
    /// The errors of each camera, in the dataset's order. Empty for a single one.
    #[serde(default)]
    pub cameras: Vec<CameraErrors>,
}

/// Squared latent errors of one of several cameras, by step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraErrors {
    /// Error of repeating the last observed latent.
    pub persistence: Vec<f64>,
    /// Error of the predictions under the true actions.
    pub told: Vec<f64>,
}

pub(super) fn measure(subject: &Subject, windows: &Windows, unit: usize) -> Result<Response> {
    let last = windows.last_observed(unit)?;
    let coming = windows.coming(unit)?;
    let truths: Vec<Tensor> = (0..coming.dim(0)?)
        .map(|k| coming.narrow(0, k, 1))
        .collect::<candle_core::Result<_>>()?;
    let errors = |predicted: &[Tensor]| errors(predicted, &truths);
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
        cameras: of_cameras(subject.dataset.views(), &held, &predicted, &truths)?,
    })
}

fn errors(predicted: &[Tensor], truths: &[Tensor]) -> Result<Vec<f64>> {
    let pairs = predicted.iter().zip(truths);
    pairs.map(|(a, b)| squared(a, b)).collect()
}

/// The cameras' latents (1, h, w, C) lie side by side along the width.
fn of_cameras(
    cameras: usize,
    held: &[Tensor],
    predicted: &[Tensor],
    truths: &[Tensor],
) -> Result<Vec<CameraErrors>> {
    if cameras < 2 {
        return Ok(Vec::new());
    }
    let of = (0..cameras).map(|camera| {
        let part = |frames: &[Tensor]| -> candle_core::Result<Vec<Tensor>> {
            let parts = frames.iter().map(|frame| {
                let width = frame.dim(2)? / cameras;
                frame.narrow(2, camera * width, width)
            });
            parts.collect()
        };
        let truths = part(truths)?;
        Ok(CameraErrors {
            persistence: errors(&part(held)?, &truths)?,
            told: errors(&part(predicted)?, &truths)?,
        })
    });
    of.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn cameras_share_the_errors_of_the_whole_picture() {
        let frame =
            |values: &[f32]| Tensor::from_slice(values, (1, 1, 4, 1), &Device::Cpu).unwrap();
        let held = [frame(&[0., 0., 0., 0.])];
        let predicted = [frame(&[1., 1., 2., 0.])];
        let truth = [frame(&[1., 2., 3., 4.])];
        let camera = |persistence, told| CameraErrors {
            persistence: vec![persistence],
            told: vec![told],
        };
        let found = of_cameras(2, &held, &predicted, &truth).unwrap();
        assert_eq!(found, [camera(5., 1.), camera(25., 17.)]);
        assert!(of_cameras(1, &held, &predicted, &truth).unwrap().is_empty());
    }
}
