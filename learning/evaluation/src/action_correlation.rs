use std::fmt;

use anyhow::{Result, ensure};
use candle_core::Tensor;
use rayon::prelude::*;
use wm_dataset::{ClipSource, Latents};
use wm_metrics::correlation::pearson;
use wm_model::transition::LoadedTransition;
use wm_motion::actions::{ActionSpace, Kind};
use wm_zoo::idm::TrainedIdm;

use crate::{ActionChange, Figure, Windows};

/// Windows computed at once.
const BATCH: usize = 16;

/// Correlation of inferred with true actions, over all windows and all k actions of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Correlation {
    /// Number of actions.
    pub actions: usize,
    /// Pearson's r of each varying dimension, without grippers.
    pub continuous: Vec<(String, Kind, f64)>,
    /// Share of the actions with the gripper on the right side of its middle; `None` without a gripper.
    pub gripper: Option<f64>,
}

impl Correlation {
    /// Figures of a validation.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        let groups = [
            ("r_mean", self.mean(|_| true)),
            (
                "r_translation",
                self.mean(|kind| kind == Kind::TranslationDelta),
            ),
            ("r_rotation", self.mean(|kind| kind == Kind::RotationDelta)),
        ];
        let groups = groups.into_iter();
        let mut figures: Vec<Figure> = groups
            .filter_map(|(name, r)| Some(Figure::new(name, r?)))
            .collect();
        let each = self.continuous.iter();
        figures.extend(each.map(|(name, _, r)| Figure::new(format!("r_{name}"), *r)));
        figures.extend(self.gripper.map(|right| Figure::new("gripper", right)));
        figures
    }

    /// Mean r over the dimensions of some kinds; `None` if there are none.
    #[must_use]
    pub fn mean(&self, of: impl Fn(Kind) -> bool) -> Option<f64> {
        let chosen = self.continuous.iter().filter(|(_, kind, _)| of(*kind));
        let r: Vec<f64> = chosen.map(|(_, _, r)| *r).collect();
        (!r.is_empty()).then(|| r.iter().sum::<f64>() / r.len() as f64)
    }

    /// `inferred` and `truth` are (actions, A), row by row.
    fn of(space: &ActionSpace, inferred: Vec<f32>, truth: Vec<f32>) -> Result<Self> {
        let width = space.len();
        let actions = inferred.len() / width.max(1);
        let sides: Vec<(f32, f32)> = inferred.into_iter().zip(truth).collect();
        let column = |index: usize, side: fn(&(f32, f32)) -> f32| -> Vec<f64> {
            let own = sides.iter().skip(index).step_by(width);
            own.map(|pair| f64::from(side(pair))).collect()
        };
        let dimensions = space.dimensions().iter().enumerate();
        let continuous = dimensions.filter(|(_, dimension)| !dimension.kind.is_gripper());
        let continuous = continuous.filter_map(|(index, dimension)| {
            let r = correlation(&column(index, |pair| pair.0), &column(index, |pair| pair.1))?;
            Some((dimension.name.clone(), dimension.kind, r))
        });
        let continuous = continuous.collect();
        let gripper = (space.dimensions().iter()).position(|dimension| dimension.kind.is_gripper());
        let gripper = gripper.map(|column| {
            let pairs = sides.iter().skip(column).step_by(width);
            // A gripper is -1 or 1 in model units.
            let right = pairs.filter(|(inferred, truth)| (*inferred > 0.0) == (*truth > 0.0));
            right.count() as f64 / actions.max(1) as f64
        });
        Ok(Self {
            actions,
            continuous,
            gripper,
        })
    }
}

/// Pearson's r of inferred with true values: `None` if the truth is constant, 0 if the inference is.
pub(crate) fn correlation(inferred: &[f64], truth: &[f64]) -> Option<f64> {
    let varies = truth.iter().any(|value| Some(value) != truth.first());
    varies.then(|| pearson(inferred, truth).map_or(0.0, |found| found.r))
}

impl fmt::Display for Correlation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} actions, Pearson's r:", self.actions)?;
        for Figure { name, value } in self.figures() {
            write!(f, " {} {value:.3}", name.trim_start_matches("r_"))?;
        }
        Ok(())
    }
}

/// On latents of frames, over at most `most` evenly spread windows without overlap.
///
/// # Errors
/// If no episode is long enough, or the latents are of another space.
pub fn on_real(model: &TrainedIdm, latents: &Latents, most: usize) -> Result<Correlation> {
    model.space().require(latents.space())?;
    let encoding = model.encoding();
    let horizon = model.idm().horizon();
    let clips = ClipSource::new(latents, encoding, horizon + 1)?;
    on_clips(&clips, most, |latents| Ok(model.actions(latents)?))
}

/// On at most `most` evenly spread clips of k + 1 frames without overlap. `infer` gives the k actions (B, k, A) between
/// the frames (B, k + 1, h, w, C).
///
/// # Errors
/// If a clip cannot be read, or `infer` fails.
pub fn on_clips(
    clips: &ClipSource<'_>,
    most: usize,
    infer: impl Fn(&Tensor) -> Result<Tensor> + Sync,
) -> Result<Correlation> {
    let horizon = clips.frames() - 1;
    let all = clips.all();
    let stride = all.len().div_ceil(most.max(1)).max(1);
    let chosen: Vec<_> = all.into_iter().step_by(stride).collect();
    let batches = chosen
        .par_chunks(BATCH)
        .map(|batch| {
            let (frames, truth) = clips.tensors(batch)?;
            let inferred = infer(&frames)?;
            let truth = truth.narrow(1, 0, horizon)?;
            Ok((
                inferred.flatten_all()?.to_vec1::<f32>()?,
                truth.flatten_all()?.to_vec1::<f32>()?,
            ))
        })
        .collect::<Result<Vec<_>>>()?;
    let (inferred, truth): (Vec<_>, Vec<_>) = batches.into_iter().unzip();
    Correlation::of(clips.encoding().space(), inferred.concat(), truth.concat())
}

/// On latents that `transition` predicts from the true actions: the last observed frame and its successors, for every
/// window.
///
/// # Errors
/// If the models have different steps, or the latents are of another space.
pub fn on_predicted(
    model: &TrainedIdm,
    transition: &LoadedTransition,
    windows: &Windows,
) -> Result<Correlation> {
    let encoding = model.encoding();
    let (own, others) = (encoding.frame_skip(), transition.config().frame_skip);
    ensure!(
        own == others,
        "the inverse dynamics model steps over {own} frames, the transition model over {others}"
    );
    let (horizon, width) = (model.idm().horizon(), encoding.action_dim());
    let tables = (0..windows.len())
        .into_par_iter()
        .map(|window| {
            let sampler = &transition.config().sampler;
            let predicted = windows.predict(window, transition, sampler, ActionChange::None)?;
            let mut frames = vec![windows.last_observed(window)?];
            frames.extend(predicted);
            let frames = Tensor::cat(&frames, 0)?;
            let actions = windows.actions(window)?;
            let (mut inferred, mut truth) = (Vec::new(), Vec::new());
            for first in 0..frames.dim(0)? - horizon {
                let latents = frames.narrow(0, first, horizon + 1)?.unsqueeze(0)?;
                inferred.extend(model.actions(&latents)?.flatten_all()?.to_vec1::<f32>()?);
                // The transition model may have more values, for the null action.
                let own = actions.narrow(0, first, horizon)?.narrow(1, 0, width)?;
                truth.extend(own.flatten_all()?.to_vec1::<f32>()?);
            }
            Ok((inferred, truth))
        })
        .collect::<Result<Vec<_>>>()?;
    let (inferred, truth): (Vec<_>, Vec<_>) = tables.into_iter().unzip();
    Correlation::of(encoding.space(), inferred.concat(), truth.concat())
}
