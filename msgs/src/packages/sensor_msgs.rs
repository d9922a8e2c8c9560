//! Package `sensor_msgs`: camera images.

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
