//! Package `std_srvs`: services that need no types of their own.

use serde::{Deserialize, Serialize};

/// Service: do what the service's name says.
#[derive(Clone, Copy, Debug)]
pub struct Trigger;

/// What a client of [`Trigger`] sends: IDL has no empty structs, so rosidl gives them one member.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// Of no meaning.
    pub structure_needs_at_least_one_member: u8,
}

/// Service: turn something on or off.
#[derive(Clone, Copy, Debug)]
pub struct SetBool;

/// What a client of [`SetBool`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetBoolRequest {
    /// True: on.
    pub data: bool,
}

/// What the servers of [`Trigger`] and [`SetBool`] answer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcome {
    /// Whether it was done.
    pub success: bool,
    /// If not, the reason; else what was done.
    pub message: String,
}

service!(
    Trigger,
    "std_srvs",
    "---\nbool success\nstring message\n",
    TriggerRequest,
    Outcome,
    []
);
service!(
    SetBool,
    "std_srvs",
    "bool data\n---\nbool success\nstring message\n",
    SetBoolRequest,
    Outcome,
    []
);
