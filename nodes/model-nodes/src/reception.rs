//! The reception of a message: time and publisher.

use std::time::Instant;

use wm_msgs::builtin_interfaces::Time;
use wm_ros::{Clock, PublisherId, Received};

/// When a message arrived, and from which publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reception {
    /// By the node's clock; zero until `/clock` arrives.
    pub stamp: Time,
    /// The last step of the node's clock \[ns\]: a simulated clock may be late by this much; zero for the system's.
    pub clock_step_ns: i64,
    /// By a clock that never jumps.
    pub at: Instant,
    /// Its publisher.
    pub publisher: PublisherId,
}

impl Reception {
    /// The latest possible time of arrival, by the node's clock.
    pub fn latest(&self) -> Time {
        match self.stamp.to_nanos() {
            0 => Time::default(),
            stamp_ns => Time::from_nanos(stamp_ns.saturating_add(self.clock_step_ns)),
        }
    }

    /// The reception of a message by a node with this clock.
    pub fn of<M>(received: &Received<M>, clock: &Clock) -> Self {
        Self {
            stamp: received.received,
            clock_step_ns: clock.step_ns(),
            at: received.at,
            publisher: received.publisher,
        }
    }
}
