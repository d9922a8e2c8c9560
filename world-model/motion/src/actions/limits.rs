//! Greatest plausible magnitude of a value, by kind, unit and duration.

use std::f64::consts::{PI, TAU};

use super::{Dimension, Kind};

/// Greatest speed of an end effector or of a linear joint \[m/s\]. Collaborative arms reach 1 to 2 m/s; teleoperated
/// ones stay below 1 m/s.
const SPEED: f64 = 2.5;
/// Greatest speed of a joint or of the hand's rotation \[rad/s\]. The wrists of fast arms reach 2 pi.
const TURN: f64 = 10.0;
/// Greatest distance from the base, or position of a linear joint \[m\]: an arm of 1.8 m on a rail.
const REACH: f64 = 5.0;
/// Greatest angle \[rad\]: two turns in either direction, for joints without stops.
const ANGLE: f64 = 2.0 * TAU;
/// Greatest magnitude of a gripper's opening, as a multiple of fully open.
const OPENING: f32 = 1.5;
/// Limit for unknown units, in clips.
const CLIPS: f32 = 20.0;
/// Least limit for states of unknown units, whatever their scale.
const UNKNOWN_STATE: f32 = 1000.0;

/// The quantity of a unit, and its size in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    /// Metres.
    Length(f64),
    /// Radians.
    Angle(f64),
}

impl Unit {
    /// A unit by its symbol; a velocity's may end in `/s`.
    pub fn parse(symbol: &str) -> Option<Self> {
        match symbol.strip_suffix("/s").unwrap_or(symbol) {
            "m" => Some(Self::Length(1.0)),
            "cm" => Some(Self::Length(0.01)),
            "mm" => Some(Self::Length(0.001)),
            "rad" => Some(Self::Angle(1.0)),
            "deg" | "degree" | "degrees" | "°" => Some(Self::Angle(PI / 180.0)),
            _ => None,
        }
    }
}

impl Dimension {
    /// Greatest magnitude of a value \[unit\] in an action that lasts `span_s` \[s\]: 2.5 m/s and 10 rad/s for deltas and
    /// velocities, 5 m from the base and two turns for states, 1.5 times fully open for a gripper. Without a known unit,
    /// 20 clips.
    pub fn limit_over(&self, span_s: f64) -> f32 {
        if self.kind.is_gripper() {
            return self.offset.abs() + OPENING * self.clip.max(1.0) / self.scale.abs();
        }
        let (speed, place, si) = match Unit::parse(&self.unit) {
            Some(Unit::Length(si)) => (SPEED, REACH, si),
            Some(Unit::Angle(si)) => (TURN, ANGLE, si),
            None => {
                let clips = self.offset.abs() + CLIPS * self.clip / self.scale.abs();
                return match self.kind.is_motion() {
                    true => clips,
                    false => clips.max(UNKNOWN_STATE),
                };
            }
        };
        let limit = match self.kind {
            Kind::TranslationDelta | Kind::RotationDelta | Kind::JointDelta => speed * span_s,
            Kind::Velocity | Kind::JointVelocity => speed,
            _ => place,
        };
        // f32 is precise enough for a limit.
        (limit / si) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_follow_kind_unit_and_duration() {
        let limit = |kind, unit: &str, span_s| {
            let dimension = Dimension {
                name: "a".into(),
                unit: unit.into(),
                kind,
                offset: 0.0,
                scale: 1.0,
                clip: 1.0,
            };
            dimension.limit_over(span_s)
        };
        for (kind, unit, span_s, expected) in [
            (Kind::TranslationDelta, "m", 0.2, 0.5),
            (Kind::TranslationDelta, "mm", 0.2, 500.0),
            (Kind::TranslationDelta, "m", 1.0 / 15.0, 2.5 / 15.0),
            (Kind::RotationDelta, "rad", 0.2, 2.0),
            (Kind::JointDelta, "deg", 0.1, 180.0 / std::f32::consts::PI),
            (Kind::JointVelocity, "rad/s", 0.1, 10.0),
            (Kind::JointVelocity, "rad/s", 10.0, 10.0),
            (Kind::Velocity, "m/s", 0.1, 2.5),
            (Kind::Position, "m", 0.2, 5.0),
            (Kind::JointPosition, "deg", 0.2, 720.0),
            (Kind::GripperBinary, "1", 0.2, 1.5),
            (Kind::JointDelta, "ticks", 0.2, 20.0),
            (Kind::JointPosition, "ticks", 0.2, 1000.0),
        ] {
            let found = limit(kind, unit, span_s);
            assert!(
                (found / expected - 1.0).abs() < 1e-6,
                "{kind:?} [{unit}]: {found}"
            );
        }
    }
}
