//! Commands to the arm, checked.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;
use wm_msgs::{
    geometry_msgs::TwistStamped,
    std_msgs::{Float64, Float64MultiArray, Header},
    wm_msgs::Action,
};

use crate::{displacement::Displacement, executor::Velocity};

/// The reason why a command is refused.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum CommandError {
    /// A value is not finite.
    #[error("its values are {values}; expected finite numbers")]
    NotFinite {
        /// The received value.
        values: String,
    },
    /// The stamp is malformed.
    #[error("the nanosec of its stamp is {0}; expected less than 1000000000")]
    Stamp(u32),
    /// The number of values is wrong.
    #[error("it has {actual} values; expected {expected}")]
    Length {
        /// The received value.
        actual: usize,
        /// The expected values, in words.
        expected: &'static str,
    },
    /// The command is in another frame.
    #[error("its frame is {actual:?}; expected base_frame, {expected:?}, or none")]
    Frame {
        /// The parameter `base_frame`.
        expected: String,
        /// The received value.
        actual: String,
    },
}

impl CommandError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "not_finite",
            Self::Stamp(_) => "bad_stamp",
            Self::Length { .. } => "wrong_length",
            Self::Frame { .. } => "wrong_frame",
        }
    }
}

/// A velocity that holds until the next command, and the displacement by earlier velocities in the same step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VelocityCommand {
    velocity: Velocity,
    /// Since when it holds in this step \[ns\].
    since_ns: i64,
    /// Displacement by earlier velocities in this step \[m, rad\].
    before: Velocity,
}

impl VelocityCommand {
    pub(super) fn new(velocity: Velocity, since_ns: i64) -> Self {
        Self {
            velocity,
            since_ns,
            before: Velocity::ZERO,
        }
    }

    /// The next velocity, from `since_ns` on.
    pub(super) fn then(self, velocity: Velocity, since_ns: i64) -> Self {
        Self {
            velocity,
            since_ns,
            before: self.displacement(since_ns),
        }
    }

    /// The mean velocity of the step from `start_ns` to `now_ns`.
    pub(super) fn mean(&self, start_ns: i64, now_ns: i64) -> Velocity {
        let seconds = seconds(start_ns, now_ns);
        if seconds <= 0.0 {
            return self.velocity;
        }
        Velocity::ZERO.plus(self.displacement(now_ns), seconds.recip())
    }

    /// The same velocity in the next step, which begins at `start_ns`.
    pub(super) fn from(self, start_ns: i64) -> Self {
        Self::new(self.velocity, start_ns)
    }

    fn displacement(&self, until_ns: i64) -> Velocity {
        let seconds = seconds(self.since_ns, until_ns).max(0.0);
        self.before.plus(self.velocity, seconds)
    }
}

fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 / 1e9
}

/// The commanded motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// A velocity until the next command.
    Velocity(VelocityCommand),
    /// A displacement in the next step.
    Delta(Displacement),
}

pub(super) fn of_twist(twist: &TwistStamped, base_frame: &str) -> Result<Velocity, CommandError> {
    check_header(&twist.header, base_frame)?;
    let (linear, angular) = (twist.twist.linear, twist.twist.angular);
    velocity([
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    ])
}

pub(super) fn of_array(array: &Float64MultiArray) -> Result<Velocity, CommandError> {
    let values = <[f64; 6]>::try_from(array.data.as_slice());
    velocity(values.map_err(|_| CommandError::Length {
        actual: array.data.len(),
        expected: "six: vx, vy, vz [m/s], wx, wy, wz [rad/s]",
    })?)
}

/// The motion, and the gripper's opening.
pub(super) fn of_action(
    action: &Action,
    base_frame: &str,
) -> Result<(Displacement, f64), CommandError> {
    check_header(&action.header, base_frame)?;
    let values = <[f32; 7]>::try_from(action.values.as_slice());
    let values = values.map_err(|_| CommandError::Length {
        actual: action.values.len(),
        expected: "seven: dx, dy, dz [m], droll, dpitch, dyaw [rad], gripper",
    })?;
    let values = values.map(f64::from);
    check_finite(&values)?;
    let [x, y, z, roll, pitch, yaw, gripper] = values;
    let delta = Displacement {
        translation: Vector3::new(x, y, z),
        turn: UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    };
    Ok((delta, gripper))
}

pub(super) fn of_gripper(gripper: &Float64) -> Result<f64, CommandError> {
    check_finite(&[gripper.data])?;
    Ok(gripper.data)
}

fn velocity(values: [f64; 6]) -> Result<Velocity, CommandError> {
    check_finite(&values)?;
    let [vx, vy, vz, wx, wy, wz] = values;
    Ok(Velocity {
        linear: [vx, vy, vz],
        angular: [wx, wy, wz],
    })
}

fn check_finite(values: &[f64]) -> Result<(), CommandError> {
    if values.iter().all(|value| value.is_finite()) {
        return Ok(());
    }
    Err(CommandError::NotFinite {
        values: format!("{values:?}"),
    })
}

/// An empty frame is valid: teleoperation does not name one.
fn check_header(header: &Header, base_frame: &str) -> Result<(), CommandError> {
    let Header { stamp, frame_id } = header;
    if stamp.checked_nanos().is_err() {
        return Err(CommandError::Stamp(stamp.nanosec));
    }
    if frame_id.is_empty() || base_frame.is_empty() || frame_id == base_frame {
        return Ok(());
    }
    Err(CommandError::Frame {
        expected: base_frame.to_owned(),
        actual: frame_id.to_owned(),
    })
}
