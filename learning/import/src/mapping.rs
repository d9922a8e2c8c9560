//! Mapping of a data set's action values to those of Bridge V2.

use std::str::FromStr;

use wm_motion::{actions::ActionSpace, motion::turn_between};

/// Number of values of an action and a state: three of position, three of rotation, the gripper.
pub(crate) const VALUES: usize = 7;

/// A data set's values of a closed and an open gripper, `CLOSED:OPEN`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperRange {
    closed: f64,
    open: f64,
}

impl GripperRange {
    /// DROID's: 0 open, 1 closed.
    pub(crate) const DROID: Self = Self {
        closed: 1.0,
        open: 0.0,
    };

    /// Converts a value to an opening, 0 closed to 1 open.
    #[must_use]
    pub fn opening(self, value: f64) -> f64 {
        (value - self.closed) / (self.open - self.closed)
    }

    /// Converts an opening to the data set's value.
    pub(crate) fn value(self, opening: f64) -> f64 {
        self.closed + opening * (self.open - self.closed)
    }

    /// Converts a value of an action to an opening, in place.
    pub fn open_to(self, value: &mut f32) {
        // Messages have single precision.
        *value = self.opening(f64::from(*value)) as f32;
    }
}

impl FromStr for GripperRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        let ends = text.split_once(':');
        let ends = ends.and_then(|(closed, open)| Some((number(closed)?, number(open)?)));
        match ends {
            Some((closed, open)) if closed != open => Ok(Self { closed, open }),
            _ => Err(format!(
                "expected CLOSED:OPEN, two different numbers, for example -1:1, got {text:?}"
            )),
        }
    }
}

/// Meaning of the first six values of an action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ActionForm {
    /// Changes between frames.
    #[default]
    Delta,
    /// Target poses of the hand in the base.
    Absolute,
    /// Velocities of the hand, per second.
    Velocity,
}

/// Mapping of a data set's action values to dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper \[0 closed .. 1 open\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionMapping {
    /// Meaning of the first six values.
    pub form: ActionForm,
    /// Metres per unit of length in the data set.
    pub translation_scale: f32,
    /// Radians per unit of angle in the data set.
    pub rotation_scale: f32,
    /// The gripper's values; `None`: 0 closed to 1 open.
    pub gripper: Option<GripperRange>,
}

impl Default for ActionMapping {
    fn default() -> Self {
        Self {
            form: ActionForm::Delta,
            translation_scale: 1.0,
            rotation_scale: 1.0,
            gripper: None,
        }
    }
}

impl ActionMapping {
    /// Maps the actions of an episode, (T, 7), in place. `states` are poses in m, rad and 0 to 1, (T, 7), or empty; `period_s` is
    /// the frame period.
    ///
    /// An absolute pose becomes the motion from a frame's state to the next state; the last one is zero. Without states, it
    /// becomes the motion from the previous action's pose.
    pub fn apply(&self, actions: &mut [[f32; VALUES]], states: &[[f32; VALUES]], period_s: f64) {
        for action in actions.iter_mut() {
            self.scale(action);
        }
        match self.form {
            ActionForm::Delta => {}
            ActionForm::Velocity => {
                for action in actions.iter_mut() {
                    for value in action.iter_mut().take(VALUES - 1) {
                        // Actions have single precision.
                        *value = (f64::from(*value) * period_s) as f32;
                    }
                }
            }
            ActionForm::Absolute => {
                let poses = match states.len() == actions.len() {
                    true => states.to_vec(),
                    false => {
                        let mut poses = actions.to_vec();
                        // The pose before the first is unknown: no motion.
                        if let Some(first) = actions.first() {
                            poses.insert(0, *first);
                        }
                        poses
                    }
                };
                let poses: Vec<_> = poses.iter().map(|pose| pose.map(f64::from)).collect();
                for (action, motion) in actions.iter_mut().zip(motions(&poses)) {
                    for (value, change) in action.iter_mut().zip(motion).take(VALUES - 1) {
                        *value = change;
                    }
                }
            }
        }
    }

    /// Maps units and gripper of one action.
    pub fn scale(&self, action: &mut [f32; VALUES]) {
        let [x, y, z, roll, pitch, yaw, gripper] = action;
        for value in [x, y, z] {
            *value *= self.translation_scale;
        }
        for value in [roll, pitch, yaw] {
            *value *= self.rotation_scale;
        }
        if let Some(range) = self.gripper {
            range.open_to(gripper);
        }
    }

    /// Maps the grippers of an action of `space`.
    pub fn map_grippers(&self, space: &ActionSpace, action: &mut [f32]) {
        if let Some(range) = self.gripper {
            for (value, dimension) in action.iter_mut().zip(space.dimensions()) {
                if dimension.kind.is_gripper() {
                    range.open_to(value);
                }
            }
        }
    }
}

/// The motions between poses, with the next gripper: (T, 7) -> (T, 7); the last one is zero. Rotations are composed: the
/// rotation from one orientation to the next, about the fixed axes of the base.
pub(crate) fn motions(poses: &[[f64; VALUES]]) -> Vec<[f32; VALUES]> {
    let next = poses.iter().skip(1).chain(poses.last());
    let pairs = poses.iter().zip(next);
    pairs
        .map(|(pose, next)| {
            let [x, y, z, roll, pitch, yaw, _] = *pose;
            let [nx, ny, nz, nroll, npitch, nyaw, gripper] = *next;
            let turn = turn_between([roll, pitch, yaw], [nroll, npitch, nyaw]);
            let [droll, dpitch, dyaw] = turn;
            // Messages have single precision.
            [nx - x, ny - y, nz - z, droll, dpitch, dyaw, gripper].map(|value| value as f32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gripper_ranges_are_parsed_and_mapped() {
        for (text, value, opening) in [
            ("-1:1", 0.0, 0.5),
            ("0:0.8", 0.8, 1.0),
            ("0:100", 25.0, 0.25),
            ("1:0", 1.0, 0.0),
        ] {
            let range: GripperRange = text.parse().unwrap();
            assert!((range.opening(value) - opening).abs() < 1e-6, "{text}");
        }
        for bad in ["", "1", "1:1", "a:b", "0:inf", "1:2:3"] {
            assert!(bad.parse::<GripperRange>().is_err(), "{bad}");
        }
    }

    #[test]
    fn absolute_poses_become_motions_with_and_without_states() {
        let pose = |x: f32, yaw: f32| [x, 0.1, 0.2, 3.1, 0.0, yaw, 1.0];
        let absolute = ActionMapping {
            form: ActionForm::Absolute,
            ..ActionMapping::default()
        };
        let near = |found: f32, expected: f32| (found - expected).abs() < 1e-5;
        // Targets are one frame ahead of the states.
        let states = [pose(0.3, 0.0), pose(0.31, 0.1), pose(0.33, 0.1)];
        let targets = [pose(0.31, 0.1), pose(0.33, 0.1), pose(0.34, 0.1)];
        let mut actions = targets;
        absolute.apply(&mut actions, &states, 0.2);
        assert!(
            near(actions[0][0], 0.01) && near(actions[0][5], 0.1),
            "{actions:?}"
        );
        assert!(
            near(actions[1][0], 0.02) && near(actions[2][0], 0.0),
            "{actions:?}"
        );
        let mut actions = targets;
        absolute.apply(&mut actions, &[], 0.2);
        assert!(
            near(actions[0][0], 0.0) && near(actions[1][0], 0.02),
            "{actions:?}"
        );
        assert!(near(actions[2][0], 0.01), "{actions:?}");
        assert_eq!(actions[2][6], 1.0);
    }

    #[test]
    fn velocities_and_units_become_deltas() {
        let mapping = ActionMapping {
            form: ActionForm::Velocity,
            translation_scale: 0.001,
            rotation_scale: std::f32::consts::PI / 180.0,
            gripper: Some("100:0".parse().unwrap()),
        };
        let mut actions = [[100.0, 0.0, -50.0, 0.0, 90.0, 0.0, 25.0]];
        mapping.apply(&mut actions, &[], 0.1);
        let expected = [0.01, 0.0, -0.005, 0.0, 0.157_079_63, 0.0, 0.75];
        for (found, expected) in actions[0].iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{actions:?}");
        }
    }
}
