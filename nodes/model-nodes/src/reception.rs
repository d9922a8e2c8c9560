//! How a message was received.

use std::time::Instant;

use wm_msgs::builtin_interfaces::Time;
use wm_ros::{Clock, PublisherId, Received};

/// When a message arrived, and from which publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reception {
    /// By the node's clock; zero while `/clock` has not come.
    pub stamp: Time,
    /// The last step of the node's clock \[ns\]: a simulated one may be late by as much, the system's has none.
    pub clock_step_ns: i64,
    /// By a clock that never jumps.
    pub at: Instant,
    /// Who sent it.
    pub publisher: PublisherId,
}

impl Reception {
    /// The latest time, by the node's clock, that it may have been.
    pub fn latest(&self) -> Time {
        match self.stamp.to_nanos() {
            0 => Time::default(),
            stamp_ns => Time::from_nanos(stamp_ns.saturating_add(self.clock_step_ns)),
        }
    }

    /// That of a message of a node with this clock.
    pub fn of<M>(received: &Received<M>, clock: &Clock) -> Self {
        Self {
            stamp: received.received,
            clock_step_ns: clock.step_ns(),
            at: received.at,
            publisher: received.publisher,
        }
    }
}
