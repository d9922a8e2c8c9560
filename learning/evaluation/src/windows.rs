use std::fmt;

use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use wm_dataset::{ClipSource, Latents};
use wm_model::{
    sampler::{Given, Rollout, Sampler},
    transition::LoadedTransition,
};
use wm_motion::actions::{ActionEncoding, ActionSpace, Kind};

/// Observed frames at the start of a prediction.
pub const CONTEXT: usize = 2;
/// Noise seed of all evaluated predictions.
pub const SEED: u64 = 0;

/// Actions of a prediction, instead of the true ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionChange {
    /// The true actions.
    None,
    /// The opposite motion: changes and velocities negated, targets mirrored at the last one before the prediction;
    /// grippers stay.
    Negated,
    /// No motion: changes, velocities and grippers zero, targets as the last one before the prediction.
    Zero,
    /// Actions of another window.
    Shuffled,
}

impl ActionChange {
    /// The wrong actions.
    pub const WRONG: [Self; 3] = [Self::Negated, Self::Zero, Self::Shuffled];

    /// Name in figures.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "true",
            Self::Negated => "negated",
            Self::Zero => "zero",
            Self::Shuffled => "shuffled",
        }
    }

    /// Whether it has an effect: a gripper's state has no opposite.
    #[must_use]
    pub fn applies_to(self, space: &ActionSpace) -> bool {
        let mut dimensions = space.dimensions().iter();
        self != Self::Negated || dimensions.any(|dimension| !dimension.kind.is_gripper())
    }
}

impl fmt::Display for ActionChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::None => "true",
            Self::Negated => "negated",
            Self::Zero => "zero",
            Self::Shuffled => "another's",
        })
    }
}

/// One window: observed frames, then frames to predict.
pub(crate) struct Window {
    /// Index of its episode.
    pub episode: usize,
    /// Index of the first frame in the dataset.
    pub first_frame: usize,
    /// (CONTEXT + K, h, w, C).
    pub frames: Tensor,
    /// (CONTEXT + K, A), by frame; the last one leads out of the window.
    pub actions: Tensor,
}

/// Windows for comparing predictions with true frames and with persistence (the last observed frame, repeated).
pub struct Windows {
    pub(crate) all: Vec<Window>,
    horizon: usize,
    /// Camera frames per model step.
    frame_skip: usize,
    values: Values,
}

impl Windows {
    /// At most `most` windows of `horizon` predicted steps, evenly spread over the episodes.
    ///
    /// # Errors
    /// If no episode is long enough.
    pub fn new(
        latents: &Latents,
        encoding: &ActionEncoding,
        horizon: usize,
        most: usize,
    ) -> Result<Self> {
        let source = ClipSource::new(latents, encoding, CONTEXT + horizon)?;
        let clips = source.all();
        let stride = clips.len().div_ceil(most.max(1)).max(1);
        let cases = clips.into_iter().step_by(stride).map(|clip| {
            let (frames, actions) = source.tensors(&[clip])?;
            Ok(Window {
                episode: clip.episode(),
                first_frame: source.first_frame(clip),
                frames: frames.squeeze(0)?,
                actions: actions.squeeze(0)?,
            })
        });
        Ok(Self {
            all: cases.collect::<Result<_>>()?,
            horizon,
            frame_skip: encoding.frame_skip(),
            values: Values::of(encoding)?,
        })
    }

    /// Number of windows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Always false: `new` rejects an empty list.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// [`Windows::ratios_with`] the model's own sampler.
    ///
    /// # Errors
    /// If the model does not fit the latents.
    pub fn ratios(&self, model: &LoadedTransition, change: ActionChange) -> Result<Vec<f64>> {
        self.ratios_with(model, &model.config().sampler, change)
    }

    /// Ratios of squared latent errors by predicted step: prediction over persistence, both summed over all windows.
    ///
    /// # Errors
    /// If the model does not fit the latents.
    pub fn ratios_with(
        &self,
        model: &LoadedTransition,
        sampler: &Sampler,
        change: ActionChange,
    ) -> Result<Vec<f64>> {
        let errors = self.errors_of_all(model, sampler, change)?;
        let sums = (0..self.horizon).map(|k| {
            let at = |errors: &[Vec<(f64, f64)>]| {
                let of_step = errors.iter().filter_map(|case| case.get(k));
                of_step.fold((0.0, 0.0), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1))
            };
            at(&errors)
        });
        Ok(sums
            .map(|(model, persistence)| model / persistence)
            .collect())
    }

    /// Squared latent errors of prediction and persistence, by window and step.
    ///
    /// # Errors
    /// If the model does not fit the latents.
    pub fn errors_of_all(
        &self,
        model: &LoadedTransition,
        sampler: &Sampler,
        change: ActionChange,
    ) -> Result<Vec<Vec<(f64, f64)>>> {
        (0..self.all.len())
            .into_par_iter()
            .map(|index| self.errors(index, model, sampler, change))
            .collect()
    }

    /// Squared errors of prediction and persistence, by step.
    fn errors(
        &self,
        index: usize,
        model: &LoadedTransition,
        sampler: &Sampler,
        change: ActionChange,
    ) -> Result<Vec<(f64, f64)>> {
        let case = self.case(index)?;
        let last = case.frames.narrow(0, CONTEXT - 1, 1)?;
        let predicted = self.predict(index, model, sampler, change)?;
        predicted
            .iter()
            .enumerate()
            .map(|(k, predicted)| {
                let truth = case.frames.narrow(0, CONTEXT + k, 1)?;
                Ok((squared(predicted, &truth)?, squared(&last, &truth)?))
            })
            .collect()
    }

    /// Predicted latents (1, h, w, C) of a window, by step.
    ///
    /// # Errors
    /// If the model does not fit the latents, or the window does not exist.
    pub fn predict(
        &self,
        index: usize,
        model: &LoadedTransition,
        sampler: &Sampler,
        change: ActionChange,
    ) -> Result<Vec<Tensor>> {
        let case = self.case(index)?;
        let context = case.frames.narrow(0, 0, CONTEXT)?.unsqueeze(0)?;
        let past = case.actions.narrow(0, 0, CONTEXT - 1)?;
        let told = self.changed(index, change)?;
        let mut rollout = Rollout::new(model, sampler, &context, Some(&past), SEED)?;
        (0..self.horizon)
            .map(|k| {
                let own = told.narrow(0, k + 1, 1)?;
                let given = Given {
                    own_action: Some(&own),
                    ..Given::default()
                };
                Ok(rollout.next_given(&told.narrow(0, k, 1)?, given)?)
            })
            .collect()
    }

    /// Dataset indices of a window's frames, observed ones first.
    ///
    /// # Errors
    /// For an unknown window.
    pub fn frame_indices(&self, index: usize) -> Result<Vec<usize>> {
        let first = self.case(index)?.first_frame;
        Ok((0..CONTEXT + self.horizon)
            .map(|i| first + i * self.frame_skip)
            .collect())
    }

    /// Observed latents (1, CONTEXT, h, w, C) of a window, and the actions (CONTEXT - 1, A) between them.
    ///
    /// # Errors
    /// For an unknown window.
    pub fn context(&self, index: usize) -> Result<(Tensor, Tensor)> {
        let window = self.case(index)?;
        Ok((
            window.frames.narrow(0, 0, CONTEXT)?.unsqueeze(0)?,
            window.actions.narrow(0, 0, CONTEXT - 1)?,
        ))
    }

    /// The last observed latent (1, h, w, C) of a window.
    ///
    /// # Errors
    /// For an unknown window.
    pub fn last_observed(&self, index: usize) -> Result<Tensor> {
        Ok(self.case(index)?.frames.narrow(0, CONTEXT - 1, 1)?)
    }

    /// The true latents after the observed ones, (K, h, w, C).
    ///
    /// # Errors
    /// For an unknown window.
    pub fn coming(&self, index: usize) -> Result<Tensor> {
        Ok(self.case(index)?.frames.narrow(0, CONTEXT, self.horizon)?)
    }

    /// The true actions (K + 1, A) of a window, from the last observed frame on.
    ///
    /// # Errors
    /// For an unknown window.
    pub fn actions(&self, index: usize) -> Result<Tensor> {
        let actions = &self.case(index)?.actions;
        Ok(actions.narrow(0, CONTEXT - 1, self.horizon + 1)?)
    }

    /// A distant window of another episode; `None` if there is only one episode.
    #[must_use]
    pub fn other(&self, index: usize) -> Option<usize> {
        let own = self.all.get(index)?.episode;
        let far = (0..self.len()).map(|by| (index + self.len() / 2 + by) % self.len());
        let mut others = far.filter(|other| {
            let other = self.all.get(*other);
            other.is_some_and(|other| other.episode != own)
        });
        others.next()
    }

    /// Whether a window's actions can be changed so, in this space: another window's need another episode.
    #[must_use]
    pub fn can_change(&self, index: usize, change: ActionChange, space: &ActionSpace) -> bool {
        change.applies_to(space)
            && (change != ActionChange::Shuffled || self.other(index).is_some())
    }

    fn case(&self, index: usize) -> Result<&Window> {
        self.all.get(index).context("no such window")
    }

    /// The changed actions (K + 1, A) of a window; the last frame carries one too.
    fn changed(&self, index: usize, change: ActionChange) -> Result<Tensor> {
        let own = self.actions(index)?;
        Ok(match change {
            ActionChange::None => own,
            ActionChange::Zero => self.values.still(&own, &self.last_target(index)?)?,
            ActionChange::Shuffled => {
                let other = self.other(index);
                self.actions(other.context("no window of another episode")?)?
            }
            ActionChange::Negated => self.values.opposite(&own, &self.last_target(index)?)?,
        })
    }

    /// The action (1, A) before the prediction.
    fn last_target(&self, index: usize) -> Result<Tensor> {
        Ok(self.case(index)?.actions.narrow(0, CONTEXT - 2, 1)?)
    }
}

/// The kinds of the values of an action, as (1, A) of ones and zeros. Values beyond the action space are none of them.
struct Values {
    /// Changes and velocities.
    motions: Tensor,
    /// Positions, orientations and joints to be reached.
    targets: Tensor,
}

impl Values {
    fn of(encoding: &ActionEncoding) -> Result<Self> {
        let of = |is_of: fn(Kind) -> bool| {
            let dimensions = encoding.space().dimensions().iter();
            let values = dimensions.map(|dimension| f32::from(u8::from(is_of(dimension.kind))));
            let rest = std::iter::repeat(0.0);
            let values: Vec<f32> = values.chain(rest).take(encoding.action_dim()).collect();
            let shape = (1, values.len());
            Tensor::from_vec(values, shape, &Device::Cpu)
        };
        Ok(Self {
            motions: of(Kind::is_motion)?,
            targets: of(|kind| !kind.is_motion() && !kind.is_gripper())?,
        })
    }

    /// The opposite of `actions` (N, A) after the target `last` (1, A).
    fn opposite(&self, actions: &Tensor, last: &Tensor) -> Result<Tensor> {
        let from_last = actions.broadcast_sub(last)?.broadcast_mul(&self.targets)?;
        let motion = (actions.broadcast_mul(&self.motions)? + from_last)?;
        Ok((actions - (motion * 2.0)?)?)
    }

    /// No motion after the target `last` (1, A), in the shape of `actions` (N, A).
    fn still(&self, actions: &Tensor, last: &Tensor) -> Result<Tensor> {
        let targets = last.broadcast_mul(&self.targets)?;
        Ok(actions.zeros_like()?.broadcast_add(&targets)?)
    }
}

/// Sum of the squared differences.
///
/// # Errors
/// If shapes differ.
pub fn squared(a: &Tensor, b: &Tensor) -> Result<f64> {
    let error = (a - b)?.sqr()?.sum_all()?.to_scalar::<f32>()?;
    Ok(f64::from(error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_actions_are_the_opposite_motion_and_no_motion() {
        let space = r#"{"name": "arm", "rate": 10.0, "dimensions": [
            {"name": "v", "unit": "rad/s", "kind": "joint_velocity"},
            {"name": "q", "unit": "rad", "kind": "joint_position"},
            {"name": "g", "unit": "1", "kind": "gripper_binary"}]}"#;
        let space: ActionSpace = serde_json::from_str(space).unwrap();
        let encoding = ActionEncoding::new(space, 4, 2, Default::default()).unwrap();
        let values = Values::of(&encoding).unwrap();
        let rows = |rows: &[[f32; 4]]| {
            Tensor::from_vec(rows.concat(), (rows.len(), 4), &Device::Cpu).unwrap()
        };
        let (actions, last) = (
            rows(&[[0.5, 1.0, 1.0, 0.0], [-0.2, 1.5, -1.0, 0.0]]),
            rows(&[[9.0, 0.8, 1.0, 0.0]]),
        );
        let of = |tensor: Result<Tensor>| tensor.unwrap().to_vec2::<f32>().unwrap();
        let opposite = of(values.opposite(&actions, &last));
        let expected = [[-0.5, 0.6, 1.0, 0.0], [0.2, 0.1, -1.0, 0.0]];
        for (row, expected) in opposite.iter().zip(expected) {
            assert!(
                row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6),
                "{row:?}"
            );
        }
        let still = of(values.still(&actions, &last));
        assert_eq!(still, [[0.0, 0.8, 0.0, 0.0]; 2]);
    }
}
