//! Rotations as roll, pitch and yaw about fixed axes (REP 103).

use nalgebra::UnitQuaternion;

/// Rotation by roll, pitch and yaw \[rad\]: about x, then y, then z of the fixed frame.
pub(crate) fn from_angles([roll, pitch, yaw]: [f32; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(roll.into(), pitch.into(), yaw.into())
}

/// Roll, pitch and yaw \[rad\] of a rotation.
pub(crate) fn to_angles(rotation: &UnitQuaternion<f64>) -> [f32; 3] {
    let (roll, pitch, yaw) = rotation.euler_angles();
    // f32 is precise enough for angles.
    [roll as f32, pitch as f32, yaw as f32]
}

/// `share` of the rotation of `angles` at constant angular velocity.
pub(crate) fn share(angles: [f32; 3], share: f64) -> UnitQuaternion<f64> {
    from_angles(angles).powf(share)
}

/// The angles of `times` the rotation of `angles`.
pub(crate) fn multiple(angles: [f32; 3], times: f64) -> [f32; 3] {
    if times == 1.0 {
        return angles;
    }
    to_angles(&share(angles, times))
}

/// The rotation from one orientation to another, as roll, pitch and yaw about the fixed axes of the base: (3) and (3)
/// \[rad\] -> (3) \[rad\], with `to` = result * `from`.
///
/// Differences of angles agree with it only for small rotations about z alone.
#[must_use]
pub fn turn_between(from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    let rotation =
        |[roll, pitch, yaw]: [f64; 3]| UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    let (roll, pitch, yaw) = (rotation(to) * rotation(from).inverse()).euler_angles();
    [roll, pitch, yaw]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn turn_between_is_about_base_axes(
            from in prop::array::uniform3(-PI..PI),
            turn in prop::array::uniform3(-0.5_f64..0.5),
        ) {
            let [roll, pitch, yaw] = turn;
            let [start_roll, start_pitch, start_yaw] = from;
            let start = UnitQuaternion::from_euler_angles(start_roll, start_pitch, start_yaw);
            let end = UnitQuaternion::from_euler_angles(roll, pitch, yaw) * start;
            let (end_roll, end_pitch, end_yaw) = end.euler_angles();
            let found = turn_between(from, [end_roll, end_pitch, end_yaw]);
            for (found, expected) in found.iter().zip(turn) {
                // Near pitch 90 degrees, roll and yaw keep half of their digits.
                prop_assert!((found - expected).abs() < 1e-6, "{found} {expected}");
            }
        }
    }

    proptest! {
        #[test]
        fn shares_compose_to_the_whole(angles in prop::array::uniform3(-0.5_f32..0.5), part in 0.0_f64..1.0) {
            let whole = share(angles, 1.0 - part) * share(angles, part);
            for (found, angle) in to_angles(&whole).iter().zip(angles) {
                prop_assert!((found - angle).abs() < 1e-6);
            }
        }
    }
}
