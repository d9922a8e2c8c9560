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

message!(
    Header,
    "std_msgs",
    "builtin_interfaces/Time stamp\nstring frame_id\n",
    [Time]
);
message!(String, "std_msgs", "string data\n", []);
message!(Bool, "std_msgs", "bool data\n", []);
message!(Float32, "std_msgs", "float32 data\n", []);
