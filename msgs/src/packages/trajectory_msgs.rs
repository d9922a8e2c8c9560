//! Package `trajectory_msgs`: where joints are to go.

use super::{builtin_interfaces::Duration, std_msgs::Header};
use serde::{Deserialize, Serialize};

/// Where joints are to be at a time. Each list is as long as the trajectory's `joint_names`, or empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Angles or lengths \[rad or m\].
    pub positions: Vec<f64>,
    /// Their rates \[rad/s or m/s\].
    pub velocities: Vec<f64>,
    /// Changes of these \[rad/s^2 or m/s^2\].
    pub accelerations: Vec<f64>,
    /// Torques or forces \[Nm or N\].
    pub effort: Vec<f64>,
    /// When, after the trajectory's start.
    pub time_from_start: Duration,
}

/// Where joints are to go.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// `stamp`: when it starts; zero: at once.
    pub header: Header,
    /// The joints' names.
    pub joint_names: Vec<String>,
    /// In order of their times.
    pub points: Vec<JointTrajectoryPoint>,
}

message!(
    JointTrajectoryPoint,
    "trajectory_msgs",
    "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n\
     builtin_interfaces/Duration time_from_start\n",
    [Duration]
);
message!(
    JointTrajectory,
    "trajectory_msgs",
    "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points\n",
    [Header, JointTrajectoryPoint]
);
