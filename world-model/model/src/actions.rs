//! Between a robot's actions in physical units and the vectors that the transition model is conditioned on.
//!
//! A physical action is Bridge V2's 7-vector at the camera's rate: dx dy dz \[m\], droll dpitch dyaw \[rad\] and the
//! gripper's opening, 0 closed to 1 open. A model action belongs to one *model step*, which spans
//! [`ActionEncoding::frame_skip`] camera frames: scaled, clipped, the gripper turned into a sign, padded with zeros.
//!
//! The scales and clips are those of the reference implementation for Bridge V2. Not here: stamps, and which actions
//! belong to which step (the predictor node aligns them).

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Length of a physical action: three translations, three rotations, the gripper.
pub const PHYSICAL_DIM: usize = 7;
/// Index of the gripper in a physical action, and in a model action.
pub const GRIPPER: usize = 6;
/// Index of the first rotation.
const ROLL: usize = 3;

/// How the camera-rate actions within one model step become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Accumulation {
    /// The mean of the scaled and clipped translations and rotations, the gripper of the last one.
    #[default]
    Mean,
    /// Only the action at the sampled frame, the first of the step: the reference's rule, which drops the others.
    Index,
}

/// What can be wrong with an action.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ActionError {
    /// Not the length that this encoding takes.
    #[error("an action has {actual} values where {expected} were expected")]
    Length {
        /// The length asked for.
        expected: usize,
        /// The length that came.
        actual: usize,
    },
    /// Not a number, or infinite.
    #[error("value {index} of an action is {value}, not a finite number")]
    NotFinite {
        /// Which value.
        index: usize,
        /// What it was.
        value: f32,
    },
    /// A model step got another number of camera-rate actions than it spans.
    #[error("a model step spans {expected} camera frames, but {actual} actions came")]
    Count {
        /// Camera frames a step.
        expected: usize,
        /// Actions that came.
        actual: usize,
    },
    /// The encoding itself cannot be used.
    #[error("action encoding: {0}")]
    Encoding(&'static str),
}

/// A physical action, its length and finiteness checked.
///
/// # Errors
/// [`ActionError::Length`] where `values` has not [`PHYSICAL_DIM`] values, [`ActionError::NotFinite`] where one is not finite.
pub fn physical(values: &[f32]) -> Result<[f32; PHYSICAL_DIM], ActionError> {
    let action = <[f32; PHYSICAL_DIM]>::try_from(values).map_err(|_| ActionError::Length {
        expected: PHYSICAL_DIM,
        actual: values.len(),
    })?;
    finite(&action)?;
    Ok(action)
}

/// The rule that turns physical actions into model actions and back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActionEncoding {
    /// Length of a model action; the values beyond [`PHYSICAL_DIM`] are zero. 7, or 10 for the published checkpoints,
    /// whose last value flags the null action.
    pub action_dim: usize,
    /// Camera frames of one model step.
    pub frame_skip: usize,
    /// How the actions within a step become one.
    pub accumulation: Accumulation,
    /// Model units a metre.
    pub translation_scale: f32,
    /// Bound of a scaled translation [model units].
    pub translation_clip: f32,
    /// Model units a radian.
    pub rotation_scale: f32,
    /// Bound of a scaled rotation [model units].
    pub rotation_clip: f32,
}

impl Default for ActionEncoding {
    fn default() -> Self {
        Self {
            action_dim: PHYSICAL_DIM,
            frame_skip: 2,
            accumulation: Accumulation::Mean,
            translation_scale: 35.0,
            translation_clip: 1.74,
            rotation_scale: 5.6,
            rotation_clip: 1.39,
        }
    }
}

impl ActionEncoding {
    /// Whether the numbers can serve: positive and finite scales and clips, room for the seven values, a step of at
    /// least one frame.
    ///
    /// # Errors
    /// [`ActionError::Encoding`] names the first field that cannot.
    pub fn validate(&self) -> Result<(), ActionError> {
        if self.action_dim < PHYSICAL_DIM {
            return Err(ActionError::Encoding("action_dim must be at least 7"));
        }
        if self.frame_skip == 0 {
            return Err(ActionError::Encoding("frame_skip must be at least 1"));
        }
        let positive = |value: f32| value.is_finite() && value > 0.0;
        if !positive(self.translation_scale) || !positive(self.rotation_scale) {
            return Err(ActionError::Encoding("scales must be positive and finite"));
        }
        if !positive(self.translation_clip) || !positive(self.rotation_clip) {
            return Err(ActionError::Encoding("clips must be positive and finite"));
        }
        Ok(())
    }

    /// One camera-rate action in model units, before skipped ones are accumulated: (7 values).
    ///
    /// # Errors
    /// See [`physical`].
    pub fn scale(&self, values: &[f32]) -> Result<[f32; PHYSICAL_DIM], ActionError> {
        let mut scaled = physical(values)?;
        for (index, value) in scaled.iter_mut().enumerate() {
            *value = match index {
                // Halves go to the even number, as in the reference (numpy): an opening of exactly 0.5 is closed.
                GRIPPER => -(2.0 * value.clamp(0.0, 1.0).round_ties_even() - 1.0),
                _ => {
                    let (scale, clip) = self.scale_and_clip(index);
                    (*value * scale).clamp(-clip, clip)
                }
            };
        }
        Ok(scaled)
    }

    /// The model action of one model step from the camera-rate actions that it spans, oldest first:
    /// (`frame_skip` actions of 7) -> (`action_dim`).
    ///
    /// # Errors
    /// [`ActionError::Count`] where another number of actions came, and those of [`physical`].
    pub fn encode_step<V: AsRef<[f32]>>(&self, actions: &[V]) -> Result<Vec<f32>, ActionError> {
        let (Some(first), Some(last)) = (actions.first(), actions.last()) else {
            return Err(ActionError::Count {
                expected: self.frame_skip,
                actual: 0,
            });
        };
        if actions.len() != self.frame_skip {
            return Err(ActionError::Count {
                expected: self.frame_skip,
                actual: actions.len(),
            });
        }
        let mut model = match self.accumulation {
            Accumulation::Index => self.scale(first.as_ref())?.to_vec(),
            Accumulation::Mean => {
                let mut sum = [0.0_f32; PHYSICAL_DIM];
                for action in actions {
                    for (total, value) in sum.iter_mut().zip(self.scale(action.as_ref())?) {
                        *total += value;
                    }
                }
                // A step holds a handful of frames: exact in f32.
                let mut mean = sum.map(|total| total / actions.len() as f32);
                if let (Some(gripper), Some(of_last)) =
                    (mean.last_mut(), self.scale(last.as_ref())?.last())
                {
                    *gripper = *of_last;
                }
                mean.to_vec()
            }
        };
        model.resize(self.action_dim, 0.0);
        Ok(model)
    }

    /// Model actions of as many whole steps as `actions` covers; a remainder shorter than a step is left out.
    ///
    /// # Errors
    /// Those of [`Self::encode_step`].
    pub fn encode_steps<V: AsRef<[f32]>>(
        &self,
        actions: &[V],
    ) -> Result<Vec<Vec<f32>>, ActionError> {
        self.validate()?;
        actions
            .chunks_exact(self.frame_skip)
            .map(|step| self.encode_step(step))
            .collect()
    }

    /// The physical delta that a model action stands for over its whole model step: translations \[m\], rotations
    /// \[rad\] (value / scale x frames of the step), and the gripper's opening, 1 below zero, else 0.
    ///
    /// # Errors
    /// [`ActionError::Length`] where `model` is not `action_dim` or 7 long, [`ActionError::NotFinite`].
    pub fn decode_step(&self, model: &[f32]) -> Result<[f32; PHYSICAL_DIM], ActionError> {
        if model.len() != self.action_dim && model.len() != PHYSICAL_DIM {
            return Err(ActionError::Length {
                expected: self.action_dim,
                actual: model.len(),
            });
        }
        finite(model)?;
        let mut delta = [0.0_f32; PHYSICAL_DIM];
        for (index, (out, value)) in delta.iter_mut().zip(model).enumerate() {
            *out = match index {
                GRIPPER => f32::from(*value < 0.0),
                _ => value / self.scale_and_clip(index).0 * self.frame_skip as f32,
            };
        }
        Ok(delta)
    }

    /// Lower and upper bound of each of the seven searched values, in model units: what [`Self::scale`] can produce.
    pub fn bounds(&self) -> [(f32, f32); PHYSICAL_DIM] {
        std::array::from_fn(|index| match index {
            GRIPPER => (-1.0, 1.0),
            _ => {
                let clip = self.scale_and_clip(index).1;
                (-clip, clip)
            }
        })
    }

    fn scale_and_clip(&self, index: usize) -> (f32, f32) {
        if index < ROLL {
            (self.translation_scale, self.translation_clip)
        } else {
            (self.rotation_scale, self.rotation_clip)
        }
    }
}

fn finite(values: &[f32]) -> Result<(), ActionError> {
    match values
        .iter()
        .enumerate()
        .find(|(_, value)| !value.is_finite())
    {
        Some((index, value)) => Err(ActionError::NotFinite {
            index,
            value: *value,
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
