//! Package `rosgraph_msgs`: the simulated or replayed clock.

use super::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};

/// What `/clock` says the time is; nodes with `use_sim_time` follow it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// The time.
    pub clock: Time,
}

message!(
    Clock,
    "rosgraph_msgs",
    "builtin_interfaces/Time clock\n",
    [Time]
);
