//! Actions from the states of joints.

use std::collections::BTreeSet;

use thiserror::Error;

use crate::actions::{ActionSpace, Dimension};

/// Greatest age of a joint's state against the first joint's, if joints arrive in several messages \[ns\].
const OLDEST_NS: u64 = 1_000_000_000;
/// Most joint names in an error.
const MOST_NAMES: usize = 100;

/// States of joints at a time, as in sensor_msgs/JointState.
#[derive(Clone, Copy, Debug)]
pub struct JointSample<'a> {
    /// Their time \[ns\].
    pub at_ns: i64,
    /// Names of the joints.
    pub names: &'a [String],
    /// Positions \[rad or m\], by name; empty if unknown.
    pub positions: &'a [f64],
    /// Velocities \[rad/s or m/s\], by name; empty if unknown.
    pub velocities: &'a [f64],
}

/// A dimension without a joint of its name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("expected the joints of {space}; found no {name:?} among {found:?}")]
pub struct MissingJoint {
    /// The action space, in words.
    pub space: String,
    /// Name of the dimension.
    pub name: String,
    /// The joints that have arrived, in alphabetical order.
    pub found: Vec<String>,
}

/// A sample that is older than the one before.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("the state of the joints is {before_ns} ns older than the one before")]
pub struct LateSample {
    /// By how much \[ns\].
    pub before_ns: i64,
}

/// An action that was executed.
#[derive(Clone, Debug, PartialEq)]
pub struct JointAction {
    /// When it began \[ns\].
    pub stamp_ns: i64,
    /// Until when it lasted \[ns\].
    pub until_ns: i64,
    /// One value per dimension; NaN where neither position nor velocity is known.
    pub values: Vec<f32>,
}

/// Makes actions of the states of joints, which are found by the names of an action space's dimensions.
///
/// Each action lasts from one sample to the next. A delta is the change of the position, or else the velocity times the
/// duration; a velocity is the reported one, or else the change of the position per second; every other kind is the
/// position at the beginning.
///
/// Joints of several publishers are merged: the samples with the first dimension's joint set the times, and take the newest
/// states of the others, which may be 1 s old.
#[derive(Clone, Debug)]
pub struct JointActions {
    space: ActionSpace,
    /// The newest state for each dimension.
    newest: Vec<Option<State>>,
    /// The last complete sample; its action lasts until the next one.
    last: Option<(i64, Vec<State>)>,
    /// The action before it.
    before: Option<JointAction>,
    /// Joints that have arrived, for an error.
    names: BTreeSet<String>,
}

/// The state of one joint.
#[derive(Clone, Copy, Debug)]
struct State {
    at_ns: i64,
    position: f32,
    velocity: f32,
}

impl JointActions {
    /// No samples yet.
    pub fn new(space: ActionSpace) -> Self {
        Self {
            newest: vec![None; space.len()],
            space,
            last: None,
            before: None,
            names: BTreeSet::new(),
        }
    }

    /// Takes a sample. Returns the action that ends with it: none for the first sample, for one without the first
    /// dimension's joint, and while a joint is missing or too old.
    ///
    /// # Errors
    /// [`LateSample`]: a complete sample is older than the one before, and is left out.
    pub fn take(&mut self, sample: JointSample<'_>) -> Result<Option<JointAction>, LateSample> {
        let Some(states) = self.merge(sample) else {
            return Ok(None);
        };
        let Some((stamp_ns, last)) = &self.last else {
            self.last = Some((sample.at_ns, states));
            return Ok(None);
        };
        let span_ns = sample.at_ns.saturating_sub(*stamp_ns);
        if span_ns < 0 {
            return Err(LateSample {
                before_ns: span_ns.saturating_neg(),
            });
        }
        if span_ns == 0 {
            return Ok(None);
        }
        let action = JointAction {
            stamp_ns: *stamp_ns,
            until_ns: sample.at_ns,
            values: self.values(last, &states, span_ns),
        };
        self.last = Some((sample.at_ns, states));
        self.before = Some(action.clone());
        Ok(Some(action))
    }

    /// The action that begins with the last sample: its motion is the one before, for as long again.
    pub fn finish(&mut self) -> Option<JointAction> {
        let (stamp_ns, last) = self.last.take()?;
        let before = self.before.take();
        let span_ns = before
            .as_ref()
            .map_or(0, |before| before.until_ns - before.stamp_ns);
        let mut values = self.values(&last, &last, span_ns);
        if let Some(before) = before {
            let continued = values.iter_mut().zip(before.values);
            for ((value, before), dimension) in continued.zip(self.space.dimensions()) {
                if dimension.kind.is_motion() {
                    *value = before;
                }
            }
        }
        Some(JointAction {
            stamp_ns,
            until_ns: stamp_ns.saturating_add(span_ns),
            values,
        })
    }

    /// The first dimension without a joint, once joints have arrived.
    pub fn missing(&self) -> Option<MissingJoint> {
        let mut states = self.newest.iter().zip(self.space.dimensions());
        let (_, dimension) = states.find(|(state, _)| state.is_none())?;
        (!self.names.is_empty()).then(|| MissingJoint {
            space: self.space.to_string(),
            name: dimension.name.clone(),
            found: self.names.iter().cloned().collect(),
        })
    }

    /// Forgets all samples.
    pub fn clear(&mut self) {
        self.newest.fill(None);
        (self.last, self.before) = (None, None);
    }

    /// Takes the states of a sample. Returns those of all joints if the sample has the first one and none is too old.
    fn merge(&mut self, sample: JointSample<'_>) -> Option<Vec<State>> {
        let room = MOST_NAMES.saturating_sub(self.names.len());
        let new = sample
            .names
            .iter()
            .filter(|name| !self.names.contains(*name));
        let new: Vec<String> = new.take(room).cloned().collect();
        self.names.extend(new);
        let mut has_first = false;
        let at_ns = sample.at_ns;
        let dimensions = self.space.dimensions().iter();
        for (which, (dimension, newest)) in dimensions.zip(&mut self.newest).enumerate() {
            let Some(index) = sample.names.iter().position(|name| *name == dimension.name) else {
                continue;
            };
            has_first |= which == 0;
            // Actions are f32.
            let value = |values: &[f64]| values.get(index).map_or(f32::NAN, |value| *value as f32);
            if newest.is_none_or(|newest| newest.at_ns <= at_ns) {
                *newest = Some(State {
                    at_ns,
                    position: value(sample.positions),
                    velocity: value(sample.velocities),
                });
            }
        }
        if !has_first {
            return None;
        }
        let is_fresh = |state: &State| state.at_ns.abs_diff(at_ns) <= OLDEST_NS;
        let states = self.newest.iter().map(|state| state.filter(is_fresh));
        states.collect()
    }

    fn values(&self, from: &[State], to: &[State], span_ns: i64) -> Vec<f32> {
        let seconds = span_ns as f32 / 1e9;
        let states = from.iter().zip(to).zip(self.space.dimensions());
        let value = |((from, to), dimension): ((&State, &State), &Dimension)| {
            let change = to.position - from.position;
            if dimension.kind.is_velocity() {
                match from.velocity.is_nan() {
                    true => change / seconds,
                    false => from.velocity,
                }
            } else if !dimension.kind.is_delta() {
                from.position
            } else if from.position.is_nan() {
                from.velocity * seconds
            } else {
                change
            }
        };
        states.map(value).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::actions::Kind;

    fn space(kinds: &[(&str, Kind)]) -> ActionSpace {
        let dimension = |(name, kind): &(&str, Kind)| Dimension {
            name: (*name).into(),
            unit: "rad".into(),
            kind: *kind,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        };
        let dimensions = kinds.iter().map(dimension).collect();
        ActionSpace::new("test".into(), 5.0, dimensions).unwrap()
    }

    fn take(
        actions: &mut JointActions,
        at_ns: i64,
        names: &[&str],
        positions: &[f64],
        velocities: &[f64],
    ) -> Result<Option<JointAction>, LateSample> {
        let names: Vec<String> = names.iter().map(|name| (*name).into()).collect();
        actions.take(JointSample {
            at_ns,
            names: &names,
            positions,
            velocities,
        })
    }

    #[test]
    fn each_kind_has_its_value() {
        let kinds = [
            ("a", Kind::JointDelta),
            ("b", Kind::JointVelocity),
            ("c", Kind::JointPosition),
        ];
        let mut actions = JointActions::new(space(&kinds));
        // Other joints, and another order.
        let names = ["x", "c", "b", "a"];
        assert_eq!(
            take(&mut actions, 0, &names, &[9.0, 3.0, 2.0, 1.0], &[]),
            Ok(None)
        );
        let half = 500_000_000;
        let first = take(
            &mut actions,
            half,
            &names,
            &[9.0, 3.5, 2.5, 1.25],
            &[0.0, 0.0, 4.0, 0.0],
        );
        let first = first.unwrap().unwrap();
        assert_eq!((first.stamp_ns, first.until_ns), (0, half));
        assert_eq!(first.values, [0.25, 1.0, 3.0]);
        let last = actions.finish().unwrap();
        assert_eq!((last.stamp_ns, last.until_ns), (half, 2 * half));
        // The motion goes on; the position is the last one.
        assert_eq!(last.values, [0.25, 1.0, 3.5]);
    }

    #[test]
    fn reported_velocities_count_and_replace_missing_positions() {
        let kinds = [("a", Kind::JointDelta), ("b", Kind::JointVelocity)];
        let mut actions = JointActions::new(space(&kinds));
        take(&mut actions, 0, &["a", "b"], &[], &[0.5, 0.25]).unwrap();
        let action = take(&mut actions, 200_000_000, &["a", "b"], &[], &[0.0, 0.0]);
        assert_eq!(action.unwrap().unwrap().values, [0.1, 0.25]);
    }

    #[test]
    fn several_publishers_are_merged_at_the_first_joints_times() {
        let kinds = [("arm", Kind::JointDelta), ("hand", Kind::JointPosition)];
        let mut actions = JointActions::new(space(&kinds));
        let ms = 1_000_000;
        assert_eq!(take(&mut actions, 0, &["arm"], &[1.0], &[]), Ok(None));
        assert_eq!(actions.missing().unwrap().name, "hand");
        assert_eq!(
            take(&mut actions, 10 * ms, &["hand"], &[0.5], &[]),
            Ok(None)
        );
        assert_eq!(actions.missing(), None);
        assert_eq!(
            take(&mut actions, 100 * ms, &["arm"], &[2.0], &[]),
            Ok(None)
        );
        take(&mut actions, 110 * ms, &["hand"], &[0.75], &[]).unwrap();
        let action = take(&mut actions, 200 * ms, &["arm"], &[4.0], &[])
            .unwrap()
            .unwrap();
        assert_eq!((action.stamp_ns, action.values), (100 * ms, vec![2.0, 0.5]));
        // The hand has been silent for more than a second.
        assert_eq!(
            take(&mut actions, 1200 * ms, &["arm"], &[5.0], &[]),
            Ok(None)
        );
    }

    #[test]
    fn older_samples_are_refused_and_repeated_ones_ignored() {
        let mut actions = JointActions::new(space(&[("a", Kind::JointDelta)]));
        take(&mut actions, 1000, &["a"], &[1.0], &[]).unwrap();
        assert_eq!(take(&mut actions, 1000, &["a"], &[2.0], &[]), Ok(None));
        let late = take(&mut actions, 400, &["a"], &[5.0], &[]);
        assert_eq!(late, Err(LateSample { before_ns: 600 }));
        let action = take(&mut actions, 2000, &["a"], &[3.0], &[])
            .unwrap()
            .unwrap();
        assert_eq!((action.stamp_ns, action.values), (1000, vec![2.0]));
    }

    #[test]
    fn error_names_the_dimension_and_what_came() {
        let mut actions = JointActions::new(space(&[("a", Kind::JointDelta)]));
        assert_eq!(actions.missing(), None, "nothing has come");
        take(&mut actions, 0, &["z", "b"], &[1.0, 1.0], &[]).unwrap();
        let text = actions.missing().unwrap().to_string();
        assert!(
            text.ends_with("found no \"a\" among [\"b\", \"z\"]"),
            "{text}"
        );
    }
}
