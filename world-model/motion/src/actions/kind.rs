//! The physical quantity of a value.

use serde::{Deserialize, Serialize};

/// The physical quantity of a value, which determines how it accumulates over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Kind {
    /// Change of the end effector's position along one axis of the robot's base. Changes add up.
    TranslationDelta,
    /// Change of the end effector's orientation. Three in a row are roll, pitch and yaw about the fixed axes of the
    /// robot's base (REP 103), and compose as rotations.
    RotationDelta,
    /// Change of a joint's angle or position. Changes add up.
    JointDelta,
    /// Velocity of the end effector along or about one axis of the robot's base. It holds until the next one; an
    /// interval has the mean over time, so value times duration is the motion.
    Velocity,
    /// Velocity of a joint; accumulates as [`Self::Velocity`].
    JointVelocity,
    /// Position of the end effector along one axis. The last one holds.
    Position,
    /// One angle of the end effector's orientation. The last one holds.
    Orientation,
    /// Angle or position of a joint. The last one holds.
    JointPosition,
    /// Opening of a gripper that is either open (1) or closed (0). The last one holds.
    GripperBinary,
    /// Opening of a gripper. The last one holds.
    GripperContinuous,
}

impl Kind {
    /// Whether the value is a change, which is summed over time.
    pub fn is_delta(self) -> bool {
        matches!(
            self,
            Self::TranslationDelta | Self::RotationDelta | Self::JointDelta
        )
    }

    /// Whether the value is a velocity, which is integrated over time.
    pub fn is_velocity(self) -> bool {
        matches!(self, Self::Velocity | Self::JointVelocity)
    }

    /// Whether a value of 0 means standing still: a delta or a velocity. All other values are states, which hold until
    /// the next one.
    pub fn is_motion(self) -> bool {
        self.is_delta() || self.is_velocity()
    }

    /// Whether the value is a gripper's opening.
    pub fn is_gripper(self) -> bool {
        matches!(self, Self::GripperBinary | Self::GripperContinuous)
    }

    /// Name in messages.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::TranslationDelta => "translation delta",
            Self::RotationDelta => "rotation delta",
            Self::JointDelta => "joint delta",
            Self::Velocity => "velocity",
            Self::JointVelocity => "joint velocity",
            Self::Position => "position",
            Self::Orientation => "orientation",
            Self::JointPosition => "joint position",
            Self::GripperBinary => "binary gripper",
            Self::GripperContinuous => "gripper",
        }
    }
}
