//! Package `vision_msgs`: what the values of a mask mean.

use super::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A class of things.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VisionClass {
    /// Its value in a mask.
    pub class_id: u16,
    /// Its name.
    pub class_name: String,
}

/// What the values of a mask mean.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LabelInfo {
    /// `stamp`: since when; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// One a class.
    pub class_map: Vec<VisionClass>,
    /// Confidence from which a thing was marked, 0 to 1.
    pub threshold: f32,
}

message!(
    VisionClass,
    "vision_msgs",
    "uint16 class_id\nstring class_name\n",
    []
);
message!(
    LabelInfo,
    "vision_msgs",
    "std_msgs/Header header\nvision_msgs/VisionClass[] class_map\nfloat32 threshold\n",
    [Header, VisionClass]
);
