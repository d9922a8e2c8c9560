//! Where the motions of an end effector stand in an action.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;
use wm_motion::actions::{ActionSpace, Kind};

use super::velocity::Velocity;

/// Why actions of a space are no motions of one end effector.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "the executor takes motions of one end effector: three translation deltas [m], none or three rotation deltas [rad] \
     and at most one gripper; the action space is {space}"
)]
pub struct LayoutError {
    /// The space, in words.
    pub space: String,
}

/// Where the motions of an end effector stand in an action of a space.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    space: ActionSpace,
    /// dx, dy, dz.
    translation: [usize; 3],
    /// Roll, pitch, yaw.
    rotation: Option<[usize; 3]>,
    gripper: Option<usize>,
}

impl Layout {
    /// The layout of actions of `space`.
    ///
    /// # Errors
    /// [`LayoutError`] where the space has joints, poses, two arms, or other units.
    pub fn new(space: ActionSpace) -> Result<Self, LayoutError> {
        let wrong = || LayoutError {
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
        let gripper = match grippers.as_slice() {
            [] => None,
            [gripper] => Some(*gripper),
            _ => return Err(wrong()),
        };
        Ok(Self {
            translation,
            rotation,
            gripper,
            space,
        })
    }

    /// What the values of an action are.
    pub fn space(&self) -> &ActionSpace {
        &self.space
    }

    /// Whether actions say where a gripper is to go.
    pub fn has_gripper(&self) -> bool {
        self.gripper.is_some()
    }

    /// The velocity at which the whole motion of an action is done after `seconds`. A rotation is one about a fixed axis.
    pub fn velocity(&self, values: &[f32], seconds: f64) -> Velocity {
        let at = |index: usize| values.get(index).copied().map_or(0.0, f64::from);
        let angular = self.rotation.map_or([0.0; 3], |rotation| {
            let [roll, pitch, yaw] = rotation.map(at);
            let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw).scaled_axis();
            [turn.x, turn.y, turn.z]
        });
        Velocity {
            linear: self.translation.map(|index| at(index) / seconds),
            angular: angular.map(|angle| angle / seconds),
        }
    }

    /// The gripper's opening, 0 closed to 1 open; none where the space has no gripper.
    pub fn gripper(&self, values: &[f32]) -> Option<f64> {
        let opening = values.get(self.gripper?)?;
        Some(f64::from(*opening).clamp(0.0, 1.0))
    }

    /// The action that a velocity for `seconds` is: the inverse of [`Self::velocity`].
    pub fn action(&self, velocity: Velocity, gripper: Option<f64>, seconds: f64) -> Vec<f32> {
        let mut values = vec![0.0_f32; self.space.len()];
        let mut set = |index: usize, value: f64| {
            if let Some(slot) = values.get_mut(index) {
                // Messages carry f32, which a motion of a command period needs no more than.
                *slot = value as f32;
            }
        };
        for (index, linear) in self.translation.into_iter().zip(velocity.linear) {
            set(index, linear * seconds);
        }
        if let Some(rotation) = self.rotation {
            let turn = Vector3::from(velocity.angular) * seconds;
            let (roll, pitch, yaw) = UnitQuaternion::from_scaled_axis(turn).euler_angles();
            for (index, angle) in rotation.into_iter().zip([roll, pitch, yaw]) {
                set(index, angle);
            }
        }
        if let Some((index, gripper)) = self.gripper.zip(gripper) {
            set(index, gripper);
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_motion::actions::Dimension;

    #[test]
    fn an_action_is_a_velocity_and_back() {
        let layout = Layout::new(ActionSpace::bridge()).unwrap();
        let action = [0.01, -0.02, 0.005, 0.1, -0.05, 0.2, 1.0];
        let velocity = layout.velocity(&action, 0.2);
        assert!((velocity.linear[0] - 0.05).abs() < 1e-8);
        let back = layout.action(velocity, layout.gripper(&action), 0.2);
        for (found, expected) in back.iter().zip(action) {
            assert!((found - expected).abs() < 1e-6, "{back:?}");
        }
        let part = layout.action(velocity, None, 0.05);
        assert!((part[5] - 0.05).abs() < 2e-3, "{part:?}");
    }

    #[test]
    fn joints_are_refused_by_name() {
        let joint = Dimension {
            name: "shoulder".into(),
            unit: "rad".into(),
            kind: Kind::JointDelta,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        };
        let space = ActionSpace::new("arm".into(), 5.0, vec![joint]).unwrap();
        let error = Layout::new(space).unwrap_err().to_string();
        assert!(error.contains("arm: shoulder"), "{error}");
    }
}
