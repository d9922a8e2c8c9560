//! The robot nodes over real DDS on loopback.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod action_adapter;
mod faults;
#[path = "../../../tests/fresh_domain.rs"]
mod fresh_domain;
mod joint_trajectory;
mod peer_definitions;
#[path = "../../../tests/ros2_peer.rs"]
mod ros2_peer;
mod running;
mod sim_arm;
mod wire;
