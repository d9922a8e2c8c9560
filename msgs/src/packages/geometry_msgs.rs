//! Package `geometry_msgs`: where the arm's end effector is, and how it moves.

use super::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Forward \[m\].
    pub x: f64,
    /// Left \[m\].
    pub y: f64,
    /// Up \[m\].
    pub z: f64,
}

/// An orientation as a unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// x of the vector part.
    pub x: f64,
    /// y of the vector part.
    pub y: f64,
    /// z of the vector part.
    pub z: f64,
    /// The scalar part.
    pub w: f64,
}

/// No rotation, as in ROS: the zero quaternion is not an orientation.
impl Default for Quaternion {
    fn default() -> Self {
        Self {
            x: 0.0,
            y: 0.0,
            z: 0.0,
            w: 1.0,
        }
    }
}

/// A position and an orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Where \[m\].
    pub position: Point,
    /// Which way.
    pub orientation: Quaternion,
}

/// A pose with its time and frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// `stamp`: when the pose was measured; `frame_id`: the frame it is expressed in.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// Three numbers with a direction; the message that holds it says in which unit and frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Forward.
    pub x: f64,
    /// Left.
    pub y: f64,
    /// Up.
    pub z: f64,
}

/// A velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Of the position \[m/s\].
    pub linear: Vector3,
    /// Of the orientation, about the axes of the frame \[rad/s\].
    pub angular: Vector3,
}

/// A velocity with its time and frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// `stamp`: when the velocity holds; `frame_id`: the frame it is expressed in.
    pub header: Header,
    /// The velocity.
    pub twist: Twist,
}

/// Poses in one frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseArray {
    /// `stamp`: when the poses were measured; `frame_id`: the frame they are expressed in.
    pub header: Header,
    /// The poses.
    pub poses: Vec<Pose>,
}

/// What takes coordinates of one frame to those of another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Where the other frame is \[m\].
    pub translation: Vector3,
    /// Which way it is turned.
    pub rotation: Quaternion,
}

/// Where a frame is in another one, at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// `stamp`: when that holds; `frame_id`: the frame it is expressed in.
    pub header: Header,
    /// The frame that it tells of.
    pub child_frame_id: String,
    /// Where that frame is.
    pub transform: Transform,
}

message!(
    Point,
    "geometry_msgs",
    "float64 x\nfloat64 y\nfloat64 z\n",
    []
);
message!(
    Quaternion,
    "geometry_msgs",
    "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    []
);
message!(
    Pose,
    "geometry_msgs",
    "Point position\nQuaternion orientation\n",
    [Point, Quaternion]
);
message!(
    PoseStamped,
    "geometry_msgs",
    "std_msgs/Header header\nPose pose\n",
    [Header, Pose]
);
message!(
    Vector3,
    "geometry_msgs",
    "float64 x\nfloat64 y\nfloat64 z\n",
    []
);
message!(
    Twist,
    "geometry_msgs",
    "Vector3 linear\nVector3 angular\n",
    [Vector3]
);
message!(
    TwistStamped,
    "geometry_msgs",
    "std_msgs/Header header\nTwist twist\n",
    [Header, Twist]
);
message!(
    PoseArray,
    "geometry_msgs",
    "std_msgs/Header header\nPose[] poses\n",
    [Header, Pose]
);
message!(
    Transform,
    "geometry_msgs",
    "Vector3 translation\nQuaternion rotation\n",
    [Vector3, Quaternion]
);
message!(
    TransformStamped,
    "geometry_msgs",
    "std_msgs/Header header\nstring child_frame_id\nTransform transform\n",
    [Header, Transform]
);
