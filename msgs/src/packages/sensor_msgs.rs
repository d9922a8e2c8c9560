//! Package `sensor_msgs`: cameras and their images, joints.

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

/// A part of an image; all zero: the whole of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// Its first column \[pixel\].
    pub x_offset: u32,
    /// Its first row \[pixel\].
    pub y_offset: u32,
    /// Rows \[pixel\].
    pub height: u32,
    /// Columns \[pixel\].
    pub width: u32,
    /// Whether it is to be rectified.
    pub do_rectify: bool,
}

/// How a camera sees.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// As the image that it belongs to.
    pub header: Header,
    /// Rows \[pixel\].
    pub height: u32,
    /// Columns \[pixel\].
    pub width: u32,
    /// What `d` is about, for example `plumb_bob`.
    pub distortion_model: String,
    /// Distortion.
    pub d: Vec<f64>,
    /// Row-major 3 x 3 matrix: focal lengths and principal point \[pixel\]; the middle of the first pixel is at 0, 0.
    pub k: [f64; 9],
    /// Row-major 3 x 3 matrix: rectification.
    pub r: [f64; 9],
    /// Row-major 3 x 4 matrix: projection of the rectified image \[pixel\].
    pub p: [f64; 12],
    /// Columns of the sensor in one of the image; 0 and 1: one.
    pub binning_x: u32,
    /// Rows of the sensor in one of the image.
    pub binning_y: u32,
    /// The part of the sensor that the image shows.
    pub roi: RegionOfInterest,
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
message!(
    RegionOfInterest,
    "sensor_msgs",
    "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
    []
);
message!(
    CameraInfo,
    "sensor_msgs",
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n\
     float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi\n",
    [Header, RegionOfInterest]
);
