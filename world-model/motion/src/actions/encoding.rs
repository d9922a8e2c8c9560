//! Conversion between the motion in a model step and a model action.

use serde::{Deserialize, Serialize};

use super::{ActionError, ActionSpace, Dimension, Kind};
use crate::motion::rotation;

const MOST_VALUES: usize = 1024;
const MOST_INTERVALS: usize = 1000;

/// How the intervals of one model step become one action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Accumulation {
    /// The mean of the scaled and clipped deltas and velocities; states of the last interval.
    #[default]
    Mean,
    /// The sum of the scaled and clipped deltas; the mean of velocities (their time integral is the motion); states of
    /// the last interval.
    Sum,
    /// The first interval alone, as in the authors' release; the others are dropped.
    Index,
}

/// A model action, and how many of its values were clipped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelAction {
    /// `action_dim` values in model units.
    pub values: Vec<f32>,
    /// Clipped values, over all intervals.
    pub clipped: usize,
}

/// Conversion between physical actions and model actions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawEncoding")]
pub struct ActionEncoding {
    action_dim: usize,
    frame_skip: usize,
    accumulation: Accumulation,
    space: ActionSpace,
}

/// The serialised form. Files older than 0.1 have no `space`: they hold scales and clips of Bridge V2's seven values.
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
        // Deserialised scales and clips are still unchecked.
        let space = ActionSpace::new(
            space.name().to_owned(),
            space.rate(),
            space.dimensions().to_vec(),
        )?;
        let action_dim = raw.action_dim.unwrap_or(space.len());
        Self::new(space, action_dim, raw.frame_skip, raw.accumulation)
    }
}

/// Bridge V2, with the mean over two frames.
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
    /// An encoding to `action_dim` values (those beyond the space are zero) from `frame_skip` intervals.
    ///
    /// # Errors
    /// [`ActionError::Encoding`] if the space has more values than `action_dim`, or a number is out of range.
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

    /// The space of physical actions.
    pub fn space(&self) -> &ActionSpace {
        &self.space
    }

    /// Length of a model action. 10 for the published checkpoints: the seven values of the space, zeros, and a last
    /// value that flags the null action.
    pub fn action_dim(&self) -> usize {
        self.action_dim
    }

    /// Intervals of one model step.
    pub fn frame_skip(&self) -> usize {
        self.frame_skip
    }

    /// Combination of the intervals.
    pub fn accumulation(&self) -> Accumulation {
        self.accumulation
    }

    /// Scales and clips the motion in one interval.
    ///
    /// # Errors
    /// Those of [`ActionSpace::check`], except that implausible values are clipped.
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

    /// The model action of one step from the motion in each of its intervals, oldest first: (`frame_skip` lists of the
    /// space's values) -> (`action_dim`).
    ///
    /// # Errors
    /// [`ActionError::Count`] for a wrong number of intervals, and those of [`ActionSpace::check`]; values beyond the
    /// clip are clipped and counted.
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
            // A step has few intervals: exact in f32.
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
                // Intervals have equal length.
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

    /// The physical action over a whole model step: the deltas summed over equal intervals, the velocities and the
    /// states. Inverse of [`Self::encode_step`] within the clips.
    ///
    /// # Errors
    /// [`ActionError::Length`] if `model` has neither `action_dim` values nor those of the space;
    /// [`ActionError::NotFinite`].
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

    /// Least and greatest value that [`Self::encode_step`] gives for each value of the space.
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
    /// A value in model units, and whether it was clipped.
    pub fn to_model(&self, value: f32) -> (f32, bool) {
        let scaled = match self.kind {
            // Halves round to even, as in the authors' release (numpy): an opening of exactly 0.5 counts as closed.
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
