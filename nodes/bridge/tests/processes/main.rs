//! The bridge as a process, between nodes of this process in their own domains, and with an independent Zenoh client.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

mod access;
mod announced;
#[path = "../../../../tests/fresh_domain.rs"]
mod fresh_domain;
mod harness;
mod link;
mod lossy_link;
mod python_peer;
#[path = "../../../../tests/ros2_peer.rs"]
#[allow(dead_code, reason = "other tests need more of it")]
mod ros2_peer;
mod two_bridges;
