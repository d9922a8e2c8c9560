//! The description of actions that a model, a bag and a robot share.

use std::{collections::BTreeSet, fmt};

use serde::{Deserialize, Serialize};

use super::{ActionError, Kind};

/// Most values of an action.
pub const MAX_DIMENSIONS: usize = 32;
/// Longest name of an action space or of a dimension \[characters\].
const MAX_NAME: usize = 64;
/// Shortest duration assumed for an action of unknown duration \[s\]: 5 Hz, the slowest rate of common arms.
const LEAST_SPAN_S: f64 = 0.2;

/// One value of an action.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dimension {
    /// Name, for example `dx`.
    pub name: String,
    /// Unit, for example `m`, `rad`, or `1` for none.
    pub unit: String,
    /// Physical quantity.
    pub kind: Kind,
    /// The value that maps to 0 in model units; only states have one.
    #[serde(default)]
    pub offset: f32,
    /// Model units per `unit`. A delta is scaled per interval of the space's rate; a velocity does not depend on it.
    #[serde(default = "one")]
    pub scale: f32,
    /// Greatest magnitude in model units; values beyond are clipped.
    #[serde(default = "one")]
    pub clip: f32,
}

fn one() -> f32 {
    1.0
}

/// The values of an action, and the rate at which a model's actions are defined.
///
/// ```
/// use wm_motion::actions::ActionSpace;
///
/// let space = ActionSpace::bridge();
/// assert_eq!(space.len(), 7);
/// assert_eq!(space.to_string(), "bridge_v2: dx dy dz [m, translation delta], droll dpitch dyaw [rad, rotation delta], \
///                                gripper [1, binary gripper]");
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSpace")]
pub struct ActionSpace {
    name: String,
    rate: f64,
    dimensions: Vec<Dimension>,
}

/// The serialised form, unchecked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSpace {
    name: String,
    #[serde(default = "bridge_rate")]
    rate: f64,
    dimensions: Vec<Dimension>,
}

fn bridge_rate() -> f64 {
    ActionSpace::BRIDGE_RATE
}

impl TryFrom<RawSpace> for ActionSpace {
    type Error = ActionError;

    fn try_from(raw: RawSpace) -> Result<Self, ActionError> {
        Self::new(raw.name, raw.rate, raw.dimensions)
    }
}

impl ActionSpace {
    /// Rate of Bridge V2's actions \[Hz\].
    pub const BRIDGE_RATE: f64 = 5.0;

    /// A space of 1 to [`MAX_DIMENSIONS`] values whose model actions are defined at `rate` \[Hz\].
    ///
    /// # Errors
    /// [`ActionError::Space`] names the first invalid part.
    pub fn new(name: String, rate: f64, dimensions: Vec<Dimension>) -> Result<Self, ActionError> {
        let space = Self {
            name,
            rate,
            dimensions,
        };
        match space.problem() {
            None => Ok(space),
            Some(problem) => Err(ActionError::Space(problem)),
        }
    }

    /// The space of Bridge V2: dx dy dz \[m\] and droll dpitch dyaw \[rad\] in the robot's base frame, and the
    /// gripper's opening, with the scales and clips of the authors' release.
    pub fn bridge() -> Self {
        Self::end_effector_deltas((35.0, 1.74), (5.6, 1.39))
    }

    /// [`Self::bridge`] with other (scale, clip) of translations and rotations.
    pub(super) fn end_effector_deltas(translation: (f32, f32), rotation: (f32, f32)) -> Self {
        let dimension = |name: &str, unit: &str, kind, (scale, clip)| Dimension {
            name: name.into(),
            unit: unit.into(),
            kind,
            offset: 0.0,
            scale,
            clip,
        };
        let mut dimensions = Vec::with_capacity(7);
        for name in ["dx", "dy", "dz"] {
            dimensions.push(dimension(name, "m", Kind::TranslationDelta, translation));
        }
        for name in ["droll", "dpitch", "dyaw"] {
            dimensions.push(dimension(name, "rad", Kind::RotationDelta, rotation));
        }
        dimensions.push(dimension("gripper", "1", Kind::GripperBinary, (1.0, 1.0)));
        Self {
            name: "bridge_v2".into(),
            rate: Self::BRIDGE_RATE,
            dimensions,
        }
    }

    fn problem(&self) -> Option<String> {
        let is_name = |name: &str| !name.is_empty() && name.chars().count() <= MAX_NAME;
        if !is_name(&self.name) {
            return Some(format!("expected a name of 1 to {MAX_NAME} characters"));
        }
        if !(1..=MAX_DIMENSIONS).contains(&self.dimensions.len()) {
            return Some(format!(
                "{} dimensions; expected 1 to {MAX_DIMENSIONS}",
                self.dimensions.len()
            ));
        }
        if !(self.rate.is_finite() && (0.01..=1000.0).contains(&self.rate)) {
            return Some(format!("rate is {} Hz; expected 0.01 to 1000", self.rate));
        }
        let mut names = BTreeSet::new();
        for dimension in &self.dimensions {
            let name = &dimension.name;
            if !is_name(name) || !names.insert(name) {
                return Some(format!(
                    "dimension {name:?}: expected a unique name of 1 to {MAX_NAME} characters"
                ));
            }
            if !(dimension.scale.is_finite() && dimension.scale != 0.0) {
                return Some(format!("{name}: scale must be finite and not 0"));
            }
            if !(dimension.clip.is_finite() && dimension.clip > 0.0) {
                return Some(format!("{name}: clip must be finite and above 0"));
            }
            if !dimension.offset.is_finite()
                || (dimension.kind.is_motion() && dimension.offset != 0.0)
            {
                return Some(format!(
                    "{name}: offset must be finite, and 0 for a delta or a velocity"
                ));
            }
        }
        let is_rotation = |dimension: &&Dimension| dimension.kind == Kind::RotationDelta;
        let mut rest = self.dimensions.iter().peekable();
        while let Some(dimension) = rest.next() {
            if is_rotation(&dimension)
                && (rest.next_if(is_rotation).is_none() || rest.next_if(is_rotation).is_none())
            {
                return Some(format!(
                    "{}: rotation deltas come in threes: roll, pitch, yaw",
                    dimension.name
                ));
            }
        }
        None
    }

    /// Name of the space.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Rate at which the model's actions are defined \[Hz\].
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// The same values at another rate \[Hz\].
    ///
    /// # Errors
    /// [`ActionError::Space`] if it is not from 0.01 to 1000.
    pub fn at_rate(self, rate: f64) -> Result<Self, ActionError> {
        Self::new(self.name, rate, self.dimensions)
    }

    /// Whether a camera of `rate` \[Hz\] is fast enough: it has a frame near each action. A training treats frames of a slower
    /// one as one action apart; live, a predictor waits for frames in between.
    #[must_use]
    pub fn is_fast_enough(&self, rate: f64) -> bool {
        // Frames of a camera one twentieth slower are still near enough for a short context.
        rate * 1.05 >= self.rate
    }

    /// The values in order, at least one.
    pub fn dimensions(&self) -> &[Dimension] {
        &self.dimensions
    }

    /// Number of values.
    #[allow(clippy::len_without_is_empty)] // never empty
    pub fn len(&self) -> usize {
        self.dimensions.len()
    }

    /// Indices of the first of each three rotation deltas.
    pub(crate) fn rotations(&self) -> impl Iterator<Item = usize> + '_ {
        let is_rotation =
            |(_, dimension): &(usize, &Dimension)| dimension.kind == Kind::RotationDelta;
        let indices = self.dimensions.iter().enumerate().filter(is_rotation);
        // `new` rejects rotation deltas that are not three in a row.
        indices.step_by(3).map(|(index, _)| index)
    }

    /// Checks the values of a message whose duration is unknown.
    ///
    /// # Errors
    /// Those of [`Self::check_over`] for one interval of the rate, at least 0.2 s.
    pub fn check(&self, values: &[f32]) -> Result<(), ActionError> {
        self.check_over(values, self.rate.recip().max(LEAST_SPAN_S))
    }

    /// Checks the values of an action that lasts `span_s` \[s\].
    ///
    /// # Errors
    /// [`ActionError::Length`], [`ActionError::NotFinite`], and [`ActionError::Implausible`] for a value beyond
    /// [`Dimension::limit_over`].
    pub fn check_over(&self, values: &[f32], span_s: f64) -> Result<(), ActionError> {
        if values.len() != self.len() {
            return Err(ActionError::Length {
                expected: self.len(),
                actual: values.len(),
                space: self.to_string(),
            });
        }
        for (index, (value, dimension)) in values.iter().zip(&self.dimensions).enumerate() {
            if !value.is_finite() {
                return Err(ActionError::NotFinite {
                    index,
                    value: *value,
                });
            }
            let limit = dimension.limit_over(span_s);
            if value.abs() > limit {
                return Err(ActionError::Implausible {
                    name: dimension.name.clone(),
                    value: *value,
                    limit,
                    unit: dimension.unit.clone(),
                });
            }
        }
        Ok(())
    }

    /// Checks that `other` has the same names, units and kinds. Rates, scales and clips may differ: they belong to the
    /// model, not to the values.
    ///
    /// # Errors
    /// [`ActionError::Mismatch`] with both spaces and their owners `own` and `others`.
    pub fn expect_same(&self, other: &Self, own: &str, others: &str) -> Result<(), ActionError> {
        let alike = |(a, b): (&Dimension, &Dimension)| {
            (&a.name, &a.unit, a.kind) == (&b.name, &b.unit, b.kind)
        };
        if self.len() == other.len() && self.dimensions.iter().zip(&other.dimensions).all(alike) {
            return Ok(());
        }
        Err(ActionError::Mismatch {
            expected: format!("{own} takes {self}"),
            actual: format!("{others} has {other}"),
        })
    }
}

/// The name, then the dimensions grouped by unit and kind.
impl fmt::Display for ActionSpace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.name)?;
        let alike = |a: &Dimension, b: &Dimension| (&a.unit, a.kind) == (&b.unit, b.kind);
        for (index, group) in self.dimensions.chunk_by(alike).enumerate() {
            write!(f, "{}", if index == 0 { " " } else { ", " })?;
            for (index, dimension) in group.iter().enumerate() {
                let gap = if index == 0 { "" } else { " " };
                write!(f, "{gap}{}", dimension.name)?;
            }
            if let Some(first) = group.first() {
                write!(f, " [{}, {}]", first.unit, first.kind.name())?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn dimension(name: &str, kind: Kind) -> Dimension {
        Dimension {
            name: name.into(),
            unit: "rad".into(),
            kind,
            offset: 0.0,
            scale: 2.0,
            clip: 1.0,
        }
    }

    fn space(dimensions: Vec<Dimension>) -> Result<ActionSpace, ActionError> {
        ActionSpace::new("test".into(), 10.0, dimensions)
    }

    #[test]
    fn one_to_thirty_two_dimensions() {
        let joints = |count: usize| {
            let joint = |index| dimension(&format!("joint_{index}"), Kind::JointPosition);
            space((0..count).map(joint).collect())
        };
        assert_eq!(joints(1).unwrap().len(), 1);
        assert_eq!(joints(32).unwrap().len(), 32);
        for count in [0, 33] {
            let error = joints(count).unwrap_err().to_string();
            assert!(error.contains(&format!("{count} dimensions")), "{error}");
        }
    }

    #[test]
    fn invalid_parts_are_named() {
        let delta = |name| dimension(name, Kind::RotationDelta);
        for (dimensions, named) in [
            (vec![delta("roll"), delta("pitch")], "in threes"),
            (vec![dimension("a", Kind::JointDelta); 2], "unique name"),
            (
                vec![Dimension {
                    clip: 0.0,
                    ..dimension("grip", Kind::GripperContinuous)
                }],
                "grip: clip",
            ),
            (
                vec![Dimension {
                    scale: f32::NAN,
                    ..dimension("grip", Kind::GripperContinuous)
                }],
                "grip: scale",
            ),
        ] {
            let error = space(dimensions).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
        let two_arms = ["a", "b", "c", "d", "e", "f"].map(delta);
        let two_arms = space(two_arms.to_vec()).unwrap();
        assert_eq!(two_arms.rotations().collect::<Vec<_>>(), [0, 3]);
    }

    #[test]
    fn json_round_trips_and_invalid_json_is_rejected() {
        let bridge = ActionSpace::bridge();
        let text = serde_json::to_string(&bridge).unwrap();
        assert_eq!(serde_json::from_str::<ActionSpace>(&text).unwrap(), bridge);
        for (text, named) in [
            (r#"{"name": "x", "dimensions": []}"#, "0 dimensions"),
            (r#"{"name": "x", "dimensions": [], "rat": 5}"#, "rat"),
            (
                r#"{"name": "x", "dimensions": [{"name": "a", "unit": "m", "kind": "delta"}]}"#,
                "translation_delta",
            ),
        ] {
            let error = serde_json::from_str::<ActionSpace>(text)
                .unwrap_err()
                .to_string();
            assert!(error.contains(named), "{error}");
        }
    }

    #[test]
    fn mismatch_names_both_owners() {
        let joints = space(vec![dimension("shoulder", Kind::JointDelta)]).unwrap();
        let error = ActionSpace::bridge()
            .expect_same(&joints, "the model", "the bag")
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("the model takes bridge_v2: dx dy dz"),
            "{error}"
        );
        assert!(error.contains("the bag has test: shoulder"), "{error}");
        let faster = ActionSpace {
            rate: 30.0,
            ..ActionSpace::bridge()
        };
        assert_eq!(ActionSpace::bridge().expect_same(&faster, "", ""), Ok(()));
    }

    #[test]
    fn implausible_values_are_rejected() {
        let space = ActionSpace::bridge();
        let good = [0.01, -0.02, 0.005, 0.1, -0.05, 0.0, 1.0];
        assert_eq!(space.check(&good), Ok(()));
        for (index, value, named) in [
            (0, 1e38, "dx"),
            (4, -1e38, "dpitch"),
            (6, 1e38, "gripper"),
            (2, f32::NAN, "value 2"),
        ] {
            let mut bad = good;
            bad[index] = value;
            let error = space.check(&bad).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
        let error = space.check(&good[..6]).unwrap_err().to_string();
        assert!(
            error.contains("6 values") && error.contains("dyaw"),
            "{error}"
        );
    }
}
