//! The layout of an arm's motions in an action.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;
use wm_motion::actions::{ActionSpace, Kind};

use super::{Rates, Velocity};

/// Why actions of a space cannot be commanded.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum LayoutError {
    /// They are not motions of one end effector.
    #[error(
        "expected motions of one end effector: three translation deltas [m], none or three rotation deltas [rad] and at \
         most one gripper; the action space is {space}"
    )]
    EndEffector {
        /// The space, in words.
        space: String,
    },
    /// They are not motions of joints.
    #[error(
        "expected joints, all of them deltas or all of them positions, and at most one gripper; the action space is {space}"
    )]
    Joints {
        /// The space, in words.
        space: String,
    },
}

/// The layout of an arm's motions in an action of a space.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    space: ActionSpace,
    motion: Motion,
    gripper: Option<usize>,
}

#[derive(Clone, Debug, PartialEq)]
enum Motion {
    EndEffector {
        /// dx, dy, dz.
        translation: [usize; 3],
        /// Roll, pitch, yaw.
        rotation: Option<[usize; 3]>,
    },
    Joints {
        indices: Vec<usize>,
        /// Whether they are positions of the joints, not changes.
        are_positions: bool,
    },
}

impl Layout {
    /// The layout of actions of `space` that move an end effector.
    ///
    /// # Errors
    /// [`LayoutError::EndEffector`] if the space has joints, poses, two arms, or other units.
    pub fn new(space: ActionSpace) -> Result<Self, LayoutError> {
        let wrong = || LayoutError::EndEffector {
            space: space.to_string(),
        };
        let (mut translation, mut rotation, mut grippers) = (Vec::new(), Vec::new(), Vec::new());
        for (index, dimension) in space.dimensions().iter().enumerate() {
            match (dimension.kind, dimension.unit.as_str()) {
                (Kind::TranslationDelta, "m") => translation.push(index),
                (Kind::RotationDelta, "rad") => rotation.push(index),
                (kind, _) if kind.is_gripper() => grippers.push(index),
                _ => return Err(wrong()),
            }
        }
        let translation = <[usize; 3]>::try_from(translation).map_err(|_| wrong())?;
        let rotation = match rotation.as_slice() {
            [] => None,
            [roll, pitch, yaw] => Some([*roll, *pitch, *yaw]),
            _ => return Err(wrong()),
        };
        let gripper = at_most_one(&grippers).ok_or_else(wrong)?;
        Ok(Self {
            motion: Motion::EndEffector {
                translation,
                rotation,
            },
            gripper,
            space,
        })
    }

    /// The layout of actions of `space` that move joints.
    ///
    /// # Errors
    /// [`LayoutError::Joints`] if the space has anything else, or both deltas and positions.
    pub fn of_joints(space: ActionSpace) -> Result<Self, LayoutError> {
        let wrong = || LayoutError::Joints {
            space: space.to_string(),
        };
        let (mut deltas, mut positions, mut grippers) = (Vec::new(), Vec::new(), Vec::new());
        for (index, dimension) in space.dimensions().iter().enumerate() {
            match dimension.kind {
                Kind::JointDelta => deltas.push(index),
                Kind::JointPosition => positions.push(index),
                kind if kind.is_gripper() => grippers.push(index),
                _ => return Err(wrong()),
            }
        }
        let (indices, are_positions) = match (deltas.is_empty(), positions.is_empty()) {
            (false, true) => (deltas, false),
            (true, false) => (positions, true),
            _ => return Err(wrong()),
        };
        let gripper = at_most_one(&grippers).ok_or_else(wrong)?;
        Ok(Self {
            motion: Motion::Joints {
                indices,
                are_positions,
            },
            gripper,
            space,
        })
    }

    /// The action space.
    pub fn space(&self) -> &ActionSpace {
        &self.space
    }

    /// Number of axes: six of an end effector, or its joints.
    pub fn axes(&self) -> usize {
        match &self.motion {
            Motion::EndEffector { .. } => 6,
            Motion::Joints { indices, .. } => indices.len(),
        }
    }

    /// The names of the joints, in the order of the axes; empty for an end effector.
    pub fn joint_names(&self) -> Option<Vec<String>> {
        let Motion::Joints { indices, .. } = &self.motion else {
            return None;
        };
        let name = |index: &usize| {
            self.space
                .dimensions()
                .get(*index)
                .map(|one| one.name.clone())
        };
        Some(indices.iter().filter_map(name).collect())
    }

    /// Whether actions are positions of joints, at which a motion ends by itself.
    pub fn has_positions(&self) -> bool {
        matches!(
            self.motion,
            Motion::Joints {
                are_positions: true,
                ..
            }
        )
    }

    /// Positions of the joints after an action; `None` if actions are not positions.
    pub fn positions(&self, values: &[f32]) -> Option<Rates> {
        match &self.motion {
            Motion::Joints {
                indices,
                are_positions: true,
            } => Some(Rates::of(indices.iter().map(|index| at(values, *index)))),
            _ => None,
        }
    }

    /// The velocity of the end effector that completes an action's motion in `seconds`. A rotation is one about a fixed axis.
    /// Zero for joints.
    pub fn velocity(&self, values: &[f32], seconds: f64) -> Velocity {
        let Motion::EndEffector {
            translation,
            rotation,
        } = &self.motion
        else {
            return Velocity::ZERO;
        };
        let angular = rotation.map_or([0.0; 3], |rotation| {
            let [roll, pitch, yaw] = rotation.map(|index| at(values, index));
            let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw).scaled_axis();
            [turn.x, turn.y, turn.z]
        });
        Velocity {
            linear: translation.map(|index| at(values, index) / seconds),
            angular: angular.map(|angle| angle / seconds),
        }
    }

    /// The velocity along each axis of an action of `seconds`, of which `left` \[s\] are left when the joints are at
    /// `places`: positions are there in time, wherever they set out.
    pub fn rates(&self, values: &[f32], seconds: f64, left: f64, places: &[f64]) -> Rates {
        let Motion::Joints { indices, .. } = &self.motion else {
            return self.velocity(values, seconds).into();
        };
        match self.positions(values) {
            Some(targets) => {
                let ways = targets.as_slice().iter().zip(places);
                Rates::of(ways.map(|(target, place)| (target - place) / left))
            }
            None => Rates::of(indices.iter().map(|index| at(values, *index) / seconds)),
        }
    }

    /// Whether actions have a gripper.
    pub fn has_gripper(&self) -> bool {
        self.gripper.is_some()
    }

    /// The gripper's opening, 0 closed to 1 open; `None` if the space has no gripper.
    pub fn gripper(&self, values: &[f32]) -> Option<f64> {
        let opening = values.get(self.gripper?)?;
        Some(f64::from(*opening).clamp(0.0, 1.0))
    }

    /// The action of velocities that last for `seconds` and bring joints to `places`: the inverse of [`Self::rates`].
    pub fn action(
        &self,
        rates: Rates,
        gripper: Option<f64>,
        seconds: f64,
        places: &[f64],
    ) -> Vec<f32> {
        let mut values = vec![0.0_f32; self.space.len()];
        let mut set = |index: usize, value: f64| {
            if let Some(slot) = values.get_mut(index) {
                // Messages carry f32, which a motion of a command period needs no more than.
                *slot = value as f32;
            }
        };
        match &self.motion {
            Motion::EndEffector {
                translation,
                rotation,
            } => {
                let velocity = rates.velocity();
                for (index, linear) in translation.iter().zip(velocity.linear) {
                    set(*index, linear * seconds);
                }
                if let Some(rotation) = rotation {
                    let turn = Vector3::from(velocity.angular) * seconds;
                    let (roll, pitch, yaw) = UnitQuaternion::from_scaled_axis(turn).euler_angles();
                    for (index, angle) in rotation.iter().zip([roll, pitch, yaw]) {
                        set(*index, angle);
                    }
                }
            }
            Motion::Joints {
                indices,
                are_positions,
            } => {
                let joints = indices.iter().zip(rates.as_slice().iter().zip(places));
                for (index, (rate, place)) in joints {
                    set(
                        *index,
                        if *are_positions {
                            *place
                        } else {
                            rate * seconds
                        },
                    );
                }
            }
        }
        if let Some((index, gripper)) = self.gripper.zip(gripper) {
            set(index, gripper);
        }
        values
    }
}

fn at(values: &[f32], index: usize) -> f64 {
    values.get(index).copied().map_or(0.0, f64::from)
}

/// `None` for two: neither is preferred.
fn at_most_one(grippers: &[usize]) -> Option<Option<usize>> {
    match grippers {
        [] => Some(None),
        [gripper] => Some(Some(*gripper)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_motion::actions::Dimension;

    fn joint(name: &str, kind: Kind) -> Dimension {
        Dimension {
            name: name.into(),
            unit: "rad".into(),
            kind,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        }
    }

    fn space(dimensions: Vec<Dimension>) -> ActionSpace {
        ActionSpace::new("arm".into(), 5.0, dimensions).unwrap()
    }

    #[test]
    fn an_action_is_a_velocity_and_back() {
        let layout = Layout::new(ActionSpace::bridge()).unwrap();
        let action = [0.01, -0.02, 0.005, 0.1, -0.05, 0.2, 1.0];
        let rates = layout.rates(&action, 0.2, 0.1, &[]);
        assert!((rates.velocity().linear[0] - 0.05).abs() < 1e-8);
        let back = layout.action(rates, layout.gripper(&action), 0.2, &[]);
        for (found, expected) in back.iter().zip(action) {
            assert!((found - expected).abs() < 1e-6, "{back:?}");
        }
        let part = layout.action(rates, None, 0.05, &[]);
        assert!((part[5] - 0.05).abs() < 2e-3, "{part:?}");
    }

    #[test]
    fn joints_move_by_deltas_or_to_positions() {
        let gripper = joint("grip", Kind::GripperContinuous);
        let deltas = [
            joint("a", Kind::JointDelta),
            gripper,
            joint("b", Kind::JointDelta),
        ];
        let layout = Layout::of_joints(space(deltas.to_vec())).unwrap();
        assert_eq!(
            (layout.axes(), layout.joint_names().unwrap()),
            (2, vec!["a".into(), "b".into()])
        );
        let rates = layout.rates(&[0.1, 1.0, -0.2], 0.2, 0.1, &[5.0, 5.0]);
        for (found, expected) in rates.as_slice().iter().zip([0.5, -1.0]) {
            assert!((found - expected).abs() < 1e-6);
        }
        let back = layout.action(rates, Some(0.5), 0.2, &[0.0; 2]);
        assert!((back[0] - 0.1).abs() < 1e-6 && back[1] == 0.5, "{back:?}");

        let positions = ["a", "b"].map(|name| joint(name, Kind::JointPosition));
        let layout = Layout::of_joints(space(positions.to_vec())).unwrap();
        let rates = layout.rates(&[1.0, 0.5], 0.2, 0.1, &[0.9, 0.5]);
        for (found, expected) in rates.as_slice().iter().zip([1.0, 0.0]) {
            assert!((found - expected).abs() < 1e-6);
        }
        assert_eq!(layout.action(rates, None, 0.1, &[1.0, 0.5]), [1.0, 0.5]);
    }

    #[test]
    fn other_spaces_are_refused_by_name() {
        let delta = joint("shoulder", Kind::JointDelta);
        let error = Layout::new(space(vec![delta.clone()]))
            .unwrap_err()
            .to_string();
        assert!(error.contains("arm: shoulder"), "{error}");
        let mixed = space(vec![delta, joint("elbow", Kind::JointPosition)]);
        let error = Layout::of_joints(mixed).unwrap_err().to_string();
        assert!(error.contains("elbow"), "{error}");
        assert!(Layout::of_joints(ActionSpace::bridge()).is_err());
    }
}
