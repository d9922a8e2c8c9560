//! One participant here and others in processes, clocks and networks of their own: peers that stop, strangers on the
//! network, newcomers, real ROS 2 clients, a clock that is set back.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod announcement;
mod answers;
mod clock;
#[path = "../../../../tests/fresh_domain.rs"]
mod fresh_domain;
mod harness;
mod hosts;
mod laggards;
mod network;
mod newcomers;
#[path = "../participants/mod.rs"]
mod participants;
#[path = "../../../../tests/ros2_peer.rs"]
mod ros2_peer;
mod strangers;
