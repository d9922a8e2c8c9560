//! The kind and unit of one value, from its name and its measurements.

use wm_motion::actions::{Kind, Spread, StateRelation};

use super::Partner;
use crate::lerobot::{
    import::value_name::{Part, ValueName},
    info::STATE,
};

/// Least and greatest share of a finger's range that counts as 0 to 1.
const UNIT_RANGE: std::ops::RangeInclusive<f64> = -0.02..=1.02;

/// One value of the actions.
#[derive(Clone, Debug)]
pub(super) struct Derivation {
    pub kind: Kind,
    pub unit: &'static str,
    pub reason: String,
    pub spread: Spread,
}

/// How a value moves its partner in the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    Level,
    Velocity,
    Delta,
}

impl Form {
    pub fn of(relation: StateRelation, rate: f64) -> Self {
        match relation {
            StateRelation::Level { .. } => Self::Level,
            // A delta moves the state `rate` times a second.
            StateRelation::Change { per_second, .. } => match per_second.abs() > rate.sqrt() {
                true => Self::Delta,
                false => Self::Velocity,
            },
        }
    }
}

/// The form of all values with a relation to the state, if they have the same.
pub(super) fn shared_form(relations: &[Option<StateRelation>], rate: f64) -> Option<Form> {
    let mut forms = relations
        .iter()
        .flatten()
        .map(|found| Form::of(*found, rate));
    let first = forms.next()?;
    forms.all(|form| form == first).then_some(first)
}

/// What names and measurements show about one value.
pub(super) struct Evidence<'a> {
    pub words: &'a ValueName,
    pub spread: Spread,
    pub rate: f64,
    pub partner: Option<&'a Partner>,
    pub relation: Option<StateRelation>,
    /// The form of the other values that have a partner.
    pub shared: Option<Form>,
}

impl Evidence<'_> {
    pub fn gripper(&self, mut values: impl Iterator<Item = f32>) -> Derivation {
        let (kind, reason) = match values.all(|value| value == 0.0 || value == 1.0) {
            true => (Kind::GripperBinary, "name; only the values 0 and 1"),
            false => (
                Kind::GripperContinuous,
                "name; closed is the least value, open the greatest",
            ),
        };
        Derivation {
            kind,
            unit: "1",
            reason: reason.to_owned(),
            spread: self.spread,
        }
    }

    pub fn value(&self) -> Derivation {
        let partner = self.partner.map_or("", |partner| partner.name.as_str());
        let is_named = self.partner.is_some_and(|partner| partner.is_named);
        let by_name = if self.words.is_velocity() {
            Some(Form::Velocity)
        } else if self.words.is_delta() {
            Some(Form::Delta)
        } else {
            None
        };
        if let Some(relation) = self.relation {
            let form = match (relation, by_name) {
                // Only the size tells a velocity from a delta, and units may differ.
                (StateRelation::Change { .. }, Some(form)) => form,
                _ => Form::of(relation, self.rate),
            };
            return self.measured(form, relation, partner, by_name == Some(form));
        }
        if let Some(form) = by_name {
            return self.derivation(form, true, "name".to_owned());
        }
        if let Some(form) = self.shared {
            let reason = format!("hardly moves; as the other values of {STATE}");
            return self.derivation(form, true, reason);
        }
        if is_named {
            let reason = format!("has the name of {partner} in {STATE}");
            return self.derivation(Form::Level, true, reason);
        }
        Derivation {
            kind: Kind::Position,
            unit: "1",
            reason: "neither its name nor its values show a kind".to_owned(),
            spread: self.spread,
        }
    }

    fn measured(
        &self,
        form: Form,
        relation: StateRelation,
        partner: &str,
        is_named: bool,
    ) -> Derivation {
        let name = if is_named { "name; " } else { "" };
        match relation {
            StateRelation::Level { correlation } => {
                let reason = format!("{name}{partner} follows it (r {correlation:.2})");
                self.derivation(form, true, reason)
            }
            StateRelation::Change {
                correlation,
                per_second,
            } => {
                let (factor, per) = match form {
                    Form::Delta => (per_second / self.rate, "frame"),
                    _ => (per_second, "second"),
                };
                let is_same_unit = StateRelation::is_same_unit(factor);
                let times = match is_same_unit {
                    true => String::new(),
                    false => format!(", by {factor:.2} of its value: unknown unit"),
                };
                let reason = format!(
                    "{name}the change of {partner} per {per} follows it (r {correlation:.2}{times})"
                );
                self.derivation(form, is_same_unit, reason)
            }
        }
    }

    /// The kind and unit of a form.
    fn derivation(&self, form: Form, has_unit: bool, reason: String) -> Derivation {
        let is_angle = !matches!(self.words.part(), Part::Axis);
        let is_degrees = is_angle && self.words.is_degrees();
        let (kind, unit) = match (form, self.words.part()) {
            (Form::Level, Part::Finger) if self.is_unit_range() => {
                return Derivation {
                    kind: Kind::Position,
                    unit: "1",
                    reason: format!("{reason}; a finger from 0 to 1"),
                    spread: self.spread,
                };
            }
            (Form::Level, Part::Axis) => (Kind::Position, "m"),
            (Form::Level, Part::Turn) => (Kind::Orientation, "rad"),
            (Form::Level, _) => (Kind::JointPosition, "rad"),
            (Form::Velocity, Part::Axis) => (Kind::Velocity, "m/s"),
            (Form::Velocity, Part::Turn) => (Kind::Velocity, "rad/s"),
            (Form::Velocity, _) => (Kind::JointVelocity, "rad/s"),
            (Form::Delta, Part::Axis) => (Kind::JointDelta, "m"),
            (Form::Delta, _) => (Kind::JointDelta, "rad"),
        };
        let unit = match unit {
            "rad" if is_degrees => "deg",
            "rad/s" if is_degrees => "deg/s",
            unit => unit,
        };
        Derivation {
            kind,
            unit: if has_unit { unit } else { "1" },
            reason,
            spread: self.spread,
        }
    }

    fn is_unit_range(&self) -> bool {
        UNIT_RANGE.contains(&self.spread.least) && UNIT_RANGE.contains(&self.spread.most)
    }
}
