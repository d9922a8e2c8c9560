//! Package `std_msgs`: the header that every stamped message begins with, and single values.

use super::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};

/// When and in which frame the data of a message was captured.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Capture time of the data, never the time of publishing.
    pub stamp: Time,
    /// The coordinate frame (REP-103, REP-105), for example `camera_optical_frame`.
    pub frame_id: std::string::String,
}

/// A text.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct String {
    /// The text, UTF-8.
    pub data: std::string::String,
}

/// A truth value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bool {
    /// The value.
    pub data: bool,
}

/// A number; its topic says of what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float32 {
    /// The number.
    pub data: f32,
}

/// A number; its topic says of what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float64 {
    /// The number.
    pub data: f64,
}

/// A colour, each part 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ColorRGBA {
    /// Red.
    pub r: f32,
    /// Green.
    pub g: f32,
    /// Blue.
    pub b: f32,
    /// Opacity.
    pub a: f32,
}

/// One dimension of an array.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayDimension {
    /// What it counts.
    pub label: std::string::String,
    /// How many.
    pub size: u32,
    /// Numbers from here to the array's end: `size` x those of the dimensions within.
    pub stride: u32,
}

/// How the numbers of an array lie.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayLayout {
    /// Outermost first.
    pub dim: Vec<MultiArrayDimension>,
    /// Numbers before the array begins.
    pub data_offset: u32,
}

/// An array of numbers; its topic says of what.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float64MultiArray {
    /// How they lie.
    pub layout: MultiArrayLayout,
    /// The numbers.
    pub data: Vec<f64>,
}

message!(
    Header,
    "std_msgs",
    "builtin_interfaces/Time stamp\nstring frame_id\n",
    [Time]
);
message!(String, "std_msgs", "string data\n", []);
message!(Bool, "std_msgs", "bool data\n", []);
message!(Float32, "std_msgs", "float32 data\n", []);
message!(Float64, "std_msgs", "float64 data\n", []);
message!(
    ColorRGBA,
    "std_msgs",
    "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    []
);
message!(
    MultiArrayDimension,
    "std_msgs",
    "string label\nuint32 size\nuint32 stride\n",
    []
);
message!(
    MultiArrayLayout,
    "std_msgs",
    "MultiArrayDimension[] dim\nuint32 data_offset\n",
    [MultiArrayDimension]
);
message!(
    Float64MultiArray,
    "std_msgs",
    "MultiArrayLayout layout\nfloat64[] data\n",
    [MultiArrayLayout]
);
