//! Package `sensor_msgs`: camera images, joints.

use super::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// An uncompressed image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// `stamp`: when the frame was captured; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// Rows \[pixel\].
    pub height: u32,
    /// Columns \[pixel\].
    pub width: u32,
    /// Channels and their order, for example `rgb8`.
    pub encoding: String,
    /// 1 where numbers of more than one byte are big endian, else 0.
    pub is_bigendian: u8,
    /// Bytes from one row to the next \[byte\].
    pub step: u32,
    /// `step` x `height` bytes, row-major.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

/// A compressed image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// `stamp`: when the frame was captured; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// The codec, `jpeg` or `png`; image_transport's longer form (`rgb8; jpeg compressed bgr8`) names it too.
    pub format: String,
    /// The file's bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

/// The state of joints. Each list is as long as `name`, or empty where it is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// `stamp`: when the joints were measured.
    pub header: Header,
    /// The joints' names.
    pub name: Vec<String>,
    /// Angles or lengths \[rad or m\].
    pub position: Vec<f64>,
    /// Their rates \[rad/s or m/s\].
    pub velocity: Vec<f64>,
    /// Torques or forces \[Nm or N\].
    pub effort: Vec<f64>,
}

message!(
    Image,
    "sensor_msgs",
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n",
    [Header]
);
message!(
    CompressedImage,
    "sensor_msgs",
    "std_msgs/Header header\nstring format\nuint8[] data\n",
    [Header]
);
message!(
    JointState,
    "sensor_msgs",
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    [Header]
);
