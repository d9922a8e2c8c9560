//! How far the arm has moved since the picture changed last.

use wm_motion::actions::{ActionSpace, Dimension};

/// A motion that a camera which sees the arm shows clearly: of values in metres.
const MOVED_M: f32 = 0.02;
/// The same of values in radians.
const MOVED_RAD: f32 = 0.1;
/// The same of changes in another unit: part of the greatest usual one.
const MOVED_DELTA: f32 = 0.4;
/// The same of states in another unit: part of their greatest magnitude.
const MOVED_STATE: f32 = 0.05;

/// The range of each value of the arm's pose since the picture changed last. A range and not the sum of motions: a measured
/// pose jitters, and jitter leads nowhere.
#[derive(Clone, Debug)]
pub(super) struct Movement {
    space: ActionSpace,
    /// Of each value: now, least and greatest.
    ranges: Vec<Option<(f32, f32, f32)>>,
}

/// The value that has moved most.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ArmMotion {
    /// Its name.
    name: String,
    unit: String,
    distance: f32,
}

impl std::fmt::Display for ArmMotion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3} {} ({})", self.distance, self.unit, self.name)
    }
}

/// The range of a value beyond which the arm has moved; infinite for a gripper, which may close on nothing in sight.
fn least(dimension: &Dimension) -> f32 {
    let greatest = dimension.clip / dimension.scale.abs();
    match (dimension.unit.as_str(), dimension.kind) {
        (_, kind) if kind.is_gripper() => f32::INFINITY,
        ("m", _) => MOVED_M,
        ("rad", _) => MOVED_RAD,
        (_, kind) if kind.is_delta() => MOVED_DELTA * greatest,
        _ => MOVED_STATE * greatest,
    }
}

impl Movement {
    /// Of actions of this space.
    pub fn new(space: ActionSpace) -> Self {
        Self {
            ranges: vec![None; space.len()],
            space,
        }
    }

    /// The space of the actions.
    pub fn space(&self) -> &ActionSpace {
        &self.space
    }

    /// Takes the values of an action of its space.
    pub fn action(&mut self, values: &[f32]) {
        let dimensions = self.space.dimensions().iter().zip(values);
        for (range, (dimension, value)) in self.ranges.iter_mut().zip(dimensions) {
            *range = match (*range, dimension.kind.is_delta()) {
                (None, true) => Some((*value, value.min(0.0), value.max(0.0))),
                (None, false) => Some((*value, *value, *value)),
                (Some((now, low, high)), is_delta) => {
                    let now = if is_delta { now + value } else { *value };
                    Some((now, low.min(now), high.max(now)))
                }
            };
        }
    }

    /// The greatest motion, if a camera that sees the arm shows it clearly.
    pub fn greatest(&self) -> Option<ArmMotion> {
        let distances = self.ranges.iter().zip(self.space.dimensions());
        let distances = distances.filter_map(|(range, dimension)| {
            let (_, low, high) = (*range)?;
            let distance = high - low;
            let part = distance / least(dimension);
            (part >= 1.0).then_some((part, distance, dimension))
        });
        let most = distances.max_by(|(one, ..), (other, ..)| one.total_cmp(other))?;
        let (_, distance, dimension) = most;
        Some(ArmMotion {
            name: dimension.name.clone(),
            unit: dimension.unit.clone(),
            distance,
        })
    }

    /// The picture has changed: the arm counts as standing where it is.
    pub fn restart(&mut self) {
        self.ranges.fill(None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moved(actions: &[[f32; 7]]) -> Option<String> {
        let mut movement = Movement::new(ActionSpace::bridge());
        actions.iter().for_each(|action| movement.action(action));
        movement.greatest().map(|motion| motion.to_string())
    }

    fn along_x(value: f32) -> [f32; 7] {
        [value, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    }

    #[test]
    fn a_distance_counts_and_jitter_does_not() {
        assert_eq!(moved(&[along_x(0.005); 3]), None);
        assert_eq!(moved(&[along_x(0.005); 5]), Some("0.025 m (dx)".to_owned()));
        let jitter: Vec<_> = (0..1000)
            .map(|index| along_x(if index % 2 == 0 { 0.001 } else { -0.001 }))
            .collect();
        assert_eq!(moved(&jitter), None);
        let mut there_and_back = vec![along_x(0.01); 5];
        there_and_back.extend([along_x(-0.01); 5]);
        assert!(moved(&there_and_back).is_some());
        let mut turn = [0.0; 7];
        turn[5] = -0.2;
        assert_eq!(moved(&[turn]), Some("0.200 rad (dyaw)".to_owned()));
    }

    #[test]
    fn grippers_do_not_count() {
        let gripper = |value| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, value];
        assert_eq!(moved(&[gripper(0.0), gripper(1.0)]), None);
        let mut movement = Movement::new(ActionSpace::bridge());
        movement.action(&along_x(0.05));
        assert!(movement.greatest().is_some());
        movement.restart();
        assert_eq!(movement.greatest(), None);
    }
}
