//! The rule that turns what a robot does in a model step into a model action, and back.

use serde::{Deserialize, Serialize};

use super::{ActionError, ActionSpace, Dimension, Kind};
use crate::motion::rotation;

/// Most values of a model action.
const MOST_VALUES: usize = 1024;
/// Most intervals of a model step.
const MOST_INTERVALS: usize = 1000;

/// How the intervals of one model step become one action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Accumulation {
    /// The mean of the scaled and clipped deltas and velocities; states of the last interval.
    #[default]
    Mean,
    /// The sum of the scaled and clipped deltas; the mean of velocities, whose product with the time is the motion; states
    /// of the last interval.
    Sum,
    /// The first interval alone, that of the sampled frame: the rule of the authors' release, which drops the others.
    Index,
}

/// A model action, and how much of it was cut off.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelAction {
    /// `action_dim` values in model units.
    pub values: Vec<f32>,
    /// Values of intervals that were clipped.
    pub clipped: usize,
}

/// The rule that turns physical actions into model actions and back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawEncoding")]
pub struct ActionEncoding {
    action_dim: usize,
    frame_skip: usize,
    accumulation: Accumulation,
    space: ActionSpace,
}

/// As it is written. Before 0.1 there was no `space`: scales and clips of Bridge V2's seven values stood here.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawEncoding {
    action_dim: Option<usize>,
    #[serde(default = "bridge_skip")]
    frame_skip: usize,
    #[serde(default)]
    accumulation: Accumulation,
    space: Option<ActionSpace>,
    translation_scale: Option<f32>,
    translation_clip: Option<f32>,
    rotation_scale: Option<f32>,
    rotation_clip: Option<f32>,
}

fn bridge_skip() -> usize {
    2
}

impl TryFrom<RawEncoding> for ActionEncoding {
    type Error = ActionError;

    fn try_from(raw: RawEncoding) -> Result<Self, ActionError> {
        let scales = [
            raw.translation_scale,
            raw.translation_clip,
            raw.rotation_scale,
            raw.rotation_clip,
        ];
        let space = match raw.space {
            Some(_) if scales.iter().any(Option::is_some) => {
                let text = "translation_scale and similar keys apply only to Bridge V2; give scale and clip in `space` \
                            instead";
                return Err(ActionError::Encoding(text.into()));
            }
            Some(space) => space,
            None => ActionSpace::end_effector_deltas(
                (
                    raw.translation_scale.unwrap_or(35.0),
                    raw.translation_clip.unwrap_or(1.74),
                ),
                (
                    raw.rotation_scale.unwrap_or(5.6),
                    raw.rotation_clip.unwrap_or(1.39),
                ),
            ),
        };
        // The spaces of older files have not been checked yet.
        let space = ActionSpace::new(
            space.name().to_owned(),
            space.rate(),
            space.dimensions().to_vec(),
        )?;
        let action_dim = raw.action_dim.unwrap_or(space.len());
        Self::new(space, action_dim, raw.frame_skip, raw.accumulation)
    }
}

/// Bridge V2's, with the mean over two frames.
impl Default for ActionEncoding {
    fn default() -> Self {
        let space = ActionSpace::bridge();
        Self {
            action_dim: space.len(),
            frame_skip: 2,
            accumulation: Accumulation::Mean,
            space,
        }
    }
}

impl ActionEncoding {
    /// Model actions of `action_dim` values, those beyond the space's being zero, over `frame_skip` intervals.
    ///
    /// # Errors
    /// [`ActionError::Encoding`] where the values have no room, or a step has no interval.
    pub fn new(
        space: ActionSpace,
        action_dim: usize,
        frame_skip: usize,
        accumulation: Accumulation,
    ) -> Result<Self, ActionError> {
        if action_dim < space.len() {
            let text = format!(
                "action_dim is {action_dim}; expected at least the {} of {space}",
                space.len()
            );
            return Err(ActionError::Encoding(text));
        }
        if action_dim > MOST_VALUES {
            let text = format!("action_dim is {action_dim}; expected at most {MOST_VALUES}");
            return Err(ActionError::Encoding(text));
        }
        if !(1..=MOST_INTERVALS).contains(&frame_skip) {
            let text = format!("frame_skip is {frame_skip}; expected 1 to {MOST_INTERVALS}");
            return Err(ActionError::Encoding(text));
        }
        Ok(Self {
            action_dim,
            frame_skip,
            accumulation,
            space,
        })
    }

    /// What the values of a physical action are.
    pub fn space(&self) -> &ActionSpace {
        &self.space
    }

    /// Length of a model action; the values beyond the space's are zero. 7, or 10 for the published checkpoints, whose
    /// last value flags the null action.
    pub fn action_dim(&self) -> usize {
        self.action_dim
    }

    /// Intervals of one model step.
    pub fn frame_skip(&self) -> usize {
        self.frame_skip
    }

    /// How intervals become one action.
    pub fn accumulation(&self) -> Accumulation {
        self.accumulation
    }

    /// What happens in one interval, in model units: (values of the space), and how many values were clipped.
    ///
    /// # Errors
    /// Those of [`ActionSpace::check`], but for values that are implausible: they are clipped.
    fn scale(&self, values: &[f32]) -> Result<ModelAction, ActionError> {
        match self.space.check(values) {
            Ok(()) | Err(ActionError::Implausible { .. }) => {}
            Err(error) => return Err(error),
        }
        let mut clipped = 0;
        let scaled = values.iter().zip(self.space.dimensions());
        let values = scaled.map(|(value, dimension)| {
            let (value, is_clipped) = dimension.to_model(*value);
            clipped += usize::from(is_clipped);
            value
        });
        Ok(ModelAction {
            values: values.collect(),
            clipped,
        })
    }

    /// The model action of one step from what happens in each of its intervals, oldest first: (`frame_skip` lists of the
    /// space's values) -> (`action_dim`).
    ///
    /// # Errors
    /// [`ActionError::Count`] where another number of intervals came, and those of [`ActionSpace::check`]; what is
    /// beyond the clip is clipped and counted.
    pub fn encode_step<V: AsRef<[f32]>>(
        &self,
        intervals: &[V],
    ) -> Result<ModelAction, ActionError> {
        let count = || ActionError::Count {
            expected: self.frame_skip,
            actual: intervals.len(),
        };
        if intervals.len() != self.frame_skip {
            return Err(count());
        }
        let scaled = intervals.iter().map(|values| self.scale(values.as_ref()));
        let scaled = scaled.collect::<Result<Vec<_>, _>>()?;
        let (first, last) = scaled.first().zip(scaled.last()).ok_or_else(count)?;
        let divisor = match self.accumulation {
            Accumulation::Index => {
                let mut action = first.clone();
                action.values.resize(self.action_dim, 0.0);
                return Ok(action);
            }
            // A step holds a handful of intervals: exact in f32.
            Accumulation::Mean => scaled.len() as f32,
            Accumulation::Sum => 1.0,
        };
        let count = scaled.len() as f32;
        let mut values = Vec::with_capacity(self.action_dim);
        for (index, (dimension, of_last)) in
            self.space.dimensions().iter().zip(&last.values).enumerate()
        {
            let sum = || {
                let parts = scaled.iter().filter_map(|action| action.values.get(index));
                parts.sum::<f32>()
            };
            values.push(match dimension.kind {
                kind if kind.is_delta() => sum() / divisor,
                // Intervals are equally long.
                kind if kind.is_velocity() => sum() / count,
                _ => *of_last,
            });
        }
        values.resize(self.action_dim, 0.0);
        Ok(ModelAction {
            values,
            clipped: scaled.iter().map(|action| action.clipped).sum(),
        })
    }

    /// What a model action stands for over its whole model step, in the units of the space: the deltas of all its
    /// intervals, alike, the velocities and the states. Inverse to [`Self::encode_step`] within the clips.
    ///
    /// # Errors
    /// [`ActionError::Length`] where `model` has neither `action_dim` nor the space's values, [`ActionError::NotFinite`].
    pub fn decode_step(&self, model: &[f32]) -> Result<Vec<f32>, ActionError> {
        if model.len() != self.action_dim && model.len() != self.space.len() {
            return Err(ActionError::Length {
                expected: self.action_dim,
                actual: model.len(),
                space: self.space.to_string(),
            });
        }
        if let Some((index, value)) = (0..).zip(model).find(|(_, value)| !value.is_finite()) {
            return Err(ActionError::NotFinite {
                index,
                value: *value,
            });
        }
        let intervals = self.frame_skip as f32;
        let each = match self.accumulation {
            Accumulation::Mean | Accumulation::Index => 1.0,
            Accumulation::Sum => intervals.recip(),
        };
        let mut values = Vec::with_capacity(self.space.len());
        for (value, dimension) in model.iter().zip(self.space.dimensions()) {
            values.push(match dimension.kind {
                Kind::RotationDelta => dimension.to_physical(*value) * each,
                kind if kind.is_delta() => dimension.to_physical(*value) * each * intervals,
                _ => dimension.to_physical(*value),
            });
        }
        for first in self.space.rotations() {
            if let Some(angles) = values.get_mut(first..first + 3)
                && let [roll, pitch, yaw] = *angles
            {
                let whole = rotation::multiple([roll, pitch, yaw], self.frame_skip as f64);
                angles.copy_from_slice(&whole);
            }
        }
        Ok(values)
    }

    /// Least and greatest of each of the space's values in a model action: what [`Self::encode_step`] can produce.
    pub fn bounds(&self) -> Vec<(f32, f32)> {
        let most = |dimension: &Dimension| match self.accumulation {
            Accumulation::Sum if dimension.kind.is_delta() => {
                dimension.clip * self.frame_skip as f32
            }
            _ => dimension.clip,
        };
        let bounds = self.space.dimensions().iter().map(most);
        bounds.map(|most| (-most, most)).collect()
    }
}

impl Dimension {
    /// Model units of a value, and whether it was clipped.
    fn to_model(&self, value: f32) -> (f32, bool) {
        let scaled = match self.kind {
            // Halves go to the even number, as in the authors' release (numpy): an opening of exactly 0.5 is closed.
            Kind::GripperBinary => {
                let open = value.clamp(0.0, 1.0).round_ties_even();
                return (-(2.0 * open - 1.0), false);
            }
            Kind::GripperContinuous => -(2.0 * (value - self.offset) * self.scale - 1.0),
            _ => (value - self.offset) * self.scale,
        };
        let clipped = scaled.clamp(-self.clip, self.clip);
        (clipped, clipped != scaled)
    }

    /// The value of model units.
    fn to_physical(&self, model: f32) -> f32 {
        match self.kind {
            Kind::GripperBinary => f32::from(model < 0.0),
            Kind::GripperContinuous => (1.0 - model) / 2.0 / self.scale + self.offset,
            _ => model / self.scale + self.offset,
        }
    }
}

#[cfg(test)]
mod tests;
