//! Positions with orientations.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use thiserror::Error;
use wm_msgs::geometry_msgs;

/// Tolerance of an orientation's norm: drivers round, or compute in f32. Orientations are normalised.
const NORM_SLACK: f64 = 1e-2;

/// Why numbers are not a pose.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum PoseError {
    /// A value is not finite.
    #[error("a pose has {0}; expected finite numbers")]
    NotFinite(f64),
    /// The quaternion is not an orientation.
    #[error("the quaternion of a pose has the norm {0}; expected 1, within 1 %")]
    NotUnit(f64),
}

fn isometry(
    position: [f64; 3],
    orientation: &geometry_msgs::Quaternion,
) -> Result<Isometry3<f64>, PoseError> {
    let [x, y, z] = position;
    let turn = Quaternion::new(orientation.w, orientation.x, orientation.y, orientation.z);
    let values = [x, y, z, turn.w, turn.i, turn.j, turn.k];
    if let Some(value) = values.into_iter().find(|value| !value.is_finite()) {
        return Err(PoseError::NotFinite(value));
    }
    let norm = turn.norm();
    if (norm - 1.0).abs() > NORM_SLACK {
        return Err(PoseError::NotUnit(norm));
    }
    let turn = UnitQuaternion::from_quaternion(turn);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), turn))
}

/// Converts a pose of a message \[m\].
///
/// # Errors
/// A number is not finite, or the quaternion's norm is not 1.
pub fn of_pose(pose: &geometry_msgs::Pose) -> Result<Isometry3<f64>, PoseError> {
    let at = pose.position;
    isometry([at.x, at.y, at.z], &pose.orientation)
}

/// Converts a transform of tf \[m\].
///
/// # Errors
/// See [`of_pose`].
pub fn of_transform(transform: &geometry_msgs::Transform) -> Result<Isometry3<f64>, PoseError> {
    let at = transform.translation;
    isometry([at.x, at.y, at.z], &transform.rotation)
}

/// Interpolates from one pose to another: along a line, with a turn about one axis.
pub fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let way = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).powf(share);
    Isometry3::from_parts(
        (from.translation.vector + way * share).into(),
        turn * from.rotation,
    )
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn invalid_poses_are_named() {
        let mut turn = geometry_msgs::Quaternion {
            w: 1.0005,
            ..Default::default()
        };
        for norm in [0.9985, 0.9901, 1.0099] {
            turn.w = norm;
            let pose = isometry([1.0, 2.0, 3.0], &turn).unwrap();
            assert!((pose.rotation.norm() - 1.0).abs() < 1e-12);
        }
        for norm in [0.9899, 1.0101] {
            turn.w = norm;
            let refused = isometry([1.0, 2.0, 3.0], &turn);
            assert_eq!(refused, Err(PoseError::NotUnit(norm)));
        }
        turn.w = 1.0;
        assert_eq!(
            isometry([1.0, f64::INFINITY, 3.0], &turn),
            Err(PoseError::NotFinite(f64::INFINITY))
        );
        turn.w = 0.0;
        assert_eq!(isometry([0.0; 3], &turn), Err(PoseError::NotUnit(0.0)));
    }

    #[test]
    fn half_way_is_half_of_line_and_turn() {
        let from = Isometry3::translation(1.0, 0.0, 0.0);
        let to = Isometry3::new(Vector3::new(3.0, 2.0, 0.0), Vector3::z() * FRAC_PI_2);
        let half = between(&from, &to, 0.5);
        let expected = Isometry3::new(Vector3::new(2.0, 1.0, 0.0), Vector3::z() * FRAC_PI_2 / 2.0);
        assert!((half.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
    }
}
