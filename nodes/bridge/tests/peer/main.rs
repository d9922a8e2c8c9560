//! `wm-bridge` and the real zenoh-bridge-ros2dds (`wm-bridge-peer`), each with a domain of its own.
//!
//! `cargo test --release -p wm_bridge --features peer`

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

mod cyclone_node;
#[path = "../processes/harness.rs"]
#[allow(dead_code, reason = "the tests without this peer need more of it")]
mod harness;
mod pair;
mod ros2;
#[path = "../../../../tests/ros2_peer.rs"]
#[allow(dead_code, reason = "other tests need more of it")]
mod ros2_peer;
mod services;
mod topics;
