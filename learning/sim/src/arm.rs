//! Kinematics of a WidowX-250-like arm with six joints.
//!
//! Lengths are from Interbotix's `wx250s` description (URDF): the shoulder 0.11025 m above the table, the upper arm 0.25 m
//! up and 0.04975 m forward, the forearm 0.25 m, and 0.1587 m from the wrist to the point between the fingertips.
//! At zero, the upper arm is upright and the forearm level, pointing along +x. The three wrist axes meet in one point, so
//! the inverse is closed-form.
//!
//! The base frame has x forward, y to the robot's left, z up; its origin is on the table under the waist.
//! Joints have no limits except reach.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Height of the shoulder axis over the table, metres.
pub const SHOULDER_HEIGHT_M: f64 = 0.11025;
/// Upper arm, along its own length, metres.
pub const UPPER_ARM_M: f64 = 0.25;
/// Distance of the elbow axis in front of the upper arm, metres.
pub const ELBOW_OFFSET_M: f64 = 0.04975;
/// Distance from the elbow axis to the wrist, metres (0.175 to the forearm's roll joint, and 0.075).
pub const FOREARM_M: f64 = 0.25;
/// Distance from the wrist to the point between the fingertips, metres.
pub const HAND_M: f64 = 0.0652 + 0.0935;

/// Joint angles in radians: waist, shoulder, elbow, forearm roll, wrist angle, wrist rotate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joints(pub [f64; 6]);

/// The frames of the links in the base frame.
#[derive(Clone, Copy, Debug)]
pub struct Links {
    /// Turned by the waist, at shoulder height.
    pub waist: Isometry3<f64>,
    /// At the shoulder; z along the upper arm.
    pub upper_arm: Isometry3<f64>,
    /// At the elbow; x along the forearm.
    pub forearm: Isometry3<f64>,
    /// At the wrist, turned by the forearm roll; x along the forearm.
    pub forearm_roll: Isometry3<f64>,
    /// At the wrist, after the wrist angle; x towards the fingertips.
    pub wrist: Isometry3<f64>,
    /// Between the fingertips; x ahead of the hand. The fingers open along z (see `gripper`).
    pub tool: Isometry3<f64>,
}

/// The pose of the tool as Bridge-style actions change it: position in metres; roll, pitch and yaw in radians about the
/// fixed axes x, y and z, zero for a hand that points straight down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolPose {
    /// Position of the point between the fingertips in the base frame, metres.
    pub position: Vector3<f64>,
    /// Roll, pitch and yaw, radians.
    pub rpy: Vector3<f64>,
}

impl ToolPose {
    /// The frame of the tool: x ahead of the hand (down at zero angles), y to the robot's left, z forward.
    pub fn frame(&self) -> Isometry3<f64> {
        // Columns: the hand's x points down, its y stays y, its z becomes the base's x.
        let down = Rotation3::from_matrix_unchecked(Matrix3::new(
            0.0, 0.0, 1.0, //
            0.0, 1.0, 0.0, //
            -1.0, 0.0, 0.0,
        ));
        let turn = Rotation3::from_euler_angles(self.rpy.x, self.rpy.y, self.rpy.z);
        Isometry3::from_parts(
            Translation3::from(self.position),
            UnitQuaternion::from_rotation_matrix(&(turn * down)),
        )
    }
}

fn about_y(angle: f64) -> Isometry3<f64> {
    Isometry3::rotation(Vector3::y() * angle)
}

fn about_x(angle: f64) -> Isometry3<f64> {
    Isometry3::rotation(Vector3::x() * angle)
}

/// Forward kinematics: the frames of all links.
pub fn forward(joints: &Joints) -> Links {
    let [waist, shoulder, elbow, roll, wrist, rotate] = joints.0;
    let at_waist = Isometry3::translation(0.0, 0.0, SHOULDER_HEIGHT_M)
        * Isometry3::rotation(Vector3::z() * waist);
    let upper_arm = at_waist * about_y(shoulder);
    let forearm =
        upper_arm * Isometry3::translation(ELBOW_OFFSET_M, 0.0, UPPER_ARM_M) * about_y(elbow);
    let forearm_roll = forearm * Isometry3::translation(FOREARM_M, 0.0, 0.0) * about_x(roll);
    let wrist = forearm_roll * about_y(wrist);
    let tool = wrist * about_x(rotate) * Isometry3::translation(HAND_M, 0.0, 0.0);
    Links {
        waist: at_waist,
        upper_arm,
        forearm,
        forearm_roll,
        wrist,
        tool,
    }
}

/// Inverse kinematics, elbow up; `None` out of reach. Of the wrist's two solutions, takes the one with the smaller forearm
/// roll.
pub fn inverse(tool: &Isometry3<f64>) -> Option<Joints> {
    let wrist = tool.translation.vector - tool.rotation * Vector3::x() * HAND_M;
    let waist = wrist.y.atan2(wrist.x);
    let (ahead, up) = (wrist.x.hypot(wrist.y), wrist.z - SHOULDER_HEIGHT_M);
    let upper = UPPER_ARM_M.hypot(ELBOW_OFFSET_M);
    let reach = ahead.hypot(up);
    let cosine = (upper * upper + reach * reach - FOREARM_M * FOREARM_M) / (2.0 * upper * reach);
    if !(-1.0..=1.0).contains(&cosine) {
        return None;
    }
    // Elevation of the line from the shoulder to the elbow.
    let elevation = up.atan2(ahead) + cosine.acos();
    let shoulder = UPPER_ARM_M.atan2(ELBOW_OFFSET_M) - elevation;
    let forearm_elevation = (up - upper * elevation.sin()).atan2(ahead - upper * elevation.cos());
    let elbow = -forearm_elevation - shoulder;
    let forearm = forward(&Joints([waist, shoulder, elbow, 0.0, 0.0, 0.0])).forearm;
    // The remaining rotation is Rx(roll) Ry(wrist) Rx(rotate).
    let rest = (forearm.rotation.inverse() * tool.rotation).to_rotation_matrix();
    let m = rest.matrix();
    let wrist_angle = m.m21.hypot(m.m31).atan2(m.m11);
    let (roll, rotate) = if wrist_angle.sin().abs() < 1e-9 {
        // Roll and rotate share an axis here: the last joint takes all of the turn.
        (0.0, m.m32.atan2(m.m33))
    } else {
        (m.m21.atan2(-m.m31), m.m12.atan2(m.m13))
    };
    let [roll, wrist_angle, rotate] = if roll.abs() > std::f64::consts::FRAC_PI_2 {
        let half_turn = |a: f64| {
            if a > 0.0 {
                a - std::f64::consts::PI
            } else {
                a + std::f64::consts::PI
            }
        };
        [half_turn(roll), -wrist_angle, half_turn(rotate)]
    } else {
        [roll, wrist_angle, rotate]
    };
    Some(Joints([waist, shoulder, elbow, roll, wrist_angle, rotate]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn zero_joints_reach_straight_ahead() {
        let links = forward(&Joints([0.0; 6]));
        let expected = Vector3::new(
            ELBOW_OFFSET_M + FOREARM_M + HAND_M,
            0.0,
            SHOULDER_HEIGHT_M + UPPER_ARM_M,
        );
        assert!((links.tool.translation.vector - expected).norm() < 1e-12);
    }

    #[test]
    fn point_beyond_reach_has_no_solution() {
        let pose = ToolPose {
            position: Vector3::new(0.9, 0.0, 0.1),
            rpy: Vector3::zeros(),
        };
        assert_eq!(inverse(&pose.frame()), None);
    }

    proptest! {
        #[test]
        fn inverse_then_forward_is_the_pose(
            x in 0.15..0.36f64, y in -0.16..0.16f64, z in 0.01..0.2f64,
            roll in -0.5..0.5f64, pitch in -0.5..0.5f64, yaw in -1.4..1.4f64,
        ) {
            let pose = ToolPose { position: Vector3::new(x, y, z), rpy: Vector3::new(roll, pitch, yaw) };
            let frame = pose.frame();
            if let Some(joints) = inverse(&frame) {
                let tool = forward(&joints).tool;
                prop_assert!((tool.translation.vector - frame.translation.vector).norm() < 1e-9);
                prop_assert!(tool.rotation.angle_to(&frame.rotation) < 1e-6);
            } else {
                let wrist = frame.translation.vector - frame.rotation * Vector3::x() * HAND_M;
                let reach = (wrist - Vector3::z() * SHOULDER_HEIGHT_M).norm();
                prop_assert!(reach > FOREARM_M + UPPER_ARM_M.hypot(ELBOW_OFFSET_M) - 1e-9);
            }
        }

        #[test]
        fn forward_then_inverse_is_the_same_tool(
            waist in -0.7..0.7f64, shoulder in -0.6..0.5f64, elbow in 0.1..1.2f64,
            roll in -1.0..1.0f64, wrist in 0.3..1.5f64, rotate in -1.5..1.5f64,
        ) {
            let joints = Joints([waist, shoulder, elbow, roll, wrist, rotate]);
            let links = forward(&joints);
            let ahead = links.wrist.translation.vector;
            prop_assume!(ahead.xy().norm() > 0.02 && ahead.x > 0.0);
            let found = inverse(&links.tool);
            prop_assert!(found.is_some());
            if let Some(found) = found {
                for (a, b) in found.0.iter().zip(joints.0) {
                    prop_assert!((a - b).abs() < 1e-6, "{found:?} against {joints:?}");
                }
            }
        }
    }
}
