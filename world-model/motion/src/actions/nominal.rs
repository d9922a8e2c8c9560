//! Velocities over intervals that are longer or shorter than the model's.

use super::ActionSpace;

/// Difference from one interval that is the rounding of its nanoseconds.
const ROUNDING: f64 = 1e-6;

impl ActionSpace {
    /// Converts the values of an interval of `span_ns` to those with the same motion in one interval of the rate: a model
    /// knows no durations. Only velocities change, by the length of the interval; a delta is the motion already, and a
    /// state has no duration.
    pub fn to_nominal(&self, values: &mut [f32], span_ns: i64) {
        self.scale_velocities(values, span_ns as f64 * self.rate() / 1e9);
    }

    /// Inverse of [`Self::to_nominal`]: the velocities that make the motion of one interval of the rate in `span_ns`, if
    /// that is above 0.
    pub fn from_nominal(&self, values: &mut [f32], span_ns: i64) {
        if span_ns > 0 {
            self.scale_velocities(values, 1e9 / (span_ns as f64 * self.rate()));
        }
    }

    fn scale_velocities(&self, values: &mut [f32], factor: f64) {
        if (factor - 1.0).abs() < ROUNDING {
            return;
        }
        for (value, dimension) in values.iter_mut().zip(self.dimensions()) {
            if dimension.kind.is_velocity() {
                *value = (f64::from(*value) * factor) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;
    use crate::actions::{Dimension, Kind};

    fn space(rate: f64) -> ActionSpace {
        let dimension = |name: &str, kind| Dimension {
            name: name.into(),
            unit: "1".into(),
            kind,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        };
        let dimensions = vec![
            dimension("a", Kind::JointVelocity),
            dimension("b", Kind::JointDelta),
            dimension("c", Kind::JointPosition),
            dimension("d", Kind::Velocity),
        ];
        ActionSpace::new("test".into(), rate, dimensions).unwrap()
    }

    #[test]
    fn twice_as_long_has_twice_the_velocity_and_the_same_delta() {
        let mut values = [0.5, 0.5, 0.5, -1.0];
        space(10.0).to_nominal(&mut values, 200_000_000);
        assert_eq!(values, [1.0, 0.5, 0.5, -2.0]);
    }

    #[test]
    fn one_interval_keeps_all_bits() {
        for rate in [3.0_f64, 5.0, 7.0, 15.0, 30.0] {
            let mut values = [0.123_456_7, 1.0, 2.0, -0.3];
            // Stamps are rounded to nanoseconds.
            for span_ns in [(1e9 / rate) as i64, (1e9 / rate).ceil() as i64 + 1] {
                space(rate).to_nominal(&mut values, span_ns);
                assert_eq!(values, [0.123_456_7, 1.0, 2.0, -0.3]);
            }
        }
    }

    proptest! {
        #[test]
        fn conversion_is_inverted(
            values in prop::array::uniform4(-10.0_f32..10.0), rate in 0.1_f64..100.0, span_ns in 1_000_000_i64..10_000_000_000,
        ) {
            let space = space(rate);
            let mut found = values;
            space.to_nominal(&mut found, span_ns);
            space.from_nominal(&mut found, span_ns);
            for (found, expected) in found.iter().zip(values) {
                prop_assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{} {}", found, expected);
            }
        }
    }
}
