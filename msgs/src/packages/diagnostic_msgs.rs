//! Package `diagnostic_msgs`: how each part of the system fares.

use super::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// One named value.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What it is, with its unit.
    pub key: String,
    /// The value as text.
    pub value: String,
}

/// The state of one component.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// [`OK`](Self::OK), [`WARN`](Self::WARN), [`ERROR`](Self::ERROR) or [`STALE`](Self::STALE).
    pub level: u8,
    /// The component.
    pub name: String,
    /// The state in words.
    pub message: String,
    /// The hardware that the component runs on.
    pub hardware_id: String,
    /// Figures behind the state.
    pub values: Vec<KeyValue>,
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// It works, but somebody should look.
    pub const WARN: u8 = 1;
    /// It does not work.
    pub const ERROR: u8 = 2;
    /// No news for too long.
    pub const STALE: u8 = 3;
}

/// The states of several components at one time.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// `stamp`: when the states were gathered; `frame_id` is not used.
    pub header: Header,
    /// One a component.
    pub status: Vec<DiagnosticStatus>,
}

message!(
    KeyValue,
    "diagnostic_msgs",
    "string key\nstring value\n",
    []
);
message!(
    DiagnosticStatus,
    "diagnostic_msgs",
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\nstring hardware_id\n\
     KeyValue[] values\n",
    [KeyValue]
);
message!(
    DiagnosticArray,
    "diagnostic_msgs",
    "std_msgs/Header header\nDiagnosticStatus[] status\n",
    [Header, DiagnosticStatus]
);
