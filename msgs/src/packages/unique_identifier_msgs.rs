//! Package `unique_identifier_msgs`: what tells goals of actions apart.

use serde::{Deserialize, Serialize};

/// A universally unique identifier (RFC 9562).
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct UUID {
    /// Its bytes, the most significant first.
    pub uuid: [u8; 16],
}

message!(UUID, "unique_identifier_msgs", "uint8[16] uuid\n", []);
