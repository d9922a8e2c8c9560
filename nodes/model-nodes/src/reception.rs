//! How a message was received.

use std::time::Instant;

use wm_msgs::builtin_interfaces::Time;
use wm_ros::{PublisherId, Received};

/// When a message arrived, and from which publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reception {
    /// By the node's clock; zero while `/clock` has not come.
    pub stamp: Time,
    /// By a clock that never jumps.
    pub at: Instant,
    /// Who sent it.
    pub publisher: PublisherId,
}

impl<M> From<&Received<M>> for Reception {
    fn from(received: &Received<M>) -> Self {
        Self {
            stamp: received.received,
            at: received.at,
            publisher: received.publisher,
        }
    }
}
