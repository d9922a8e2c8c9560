//! `wm-bridge` and the real zenoh-bridge-ros2dds (`wm-bridge-peer`), each with a domain of its own.
//!
//! Cargo builds `wm-bridge` for these tests where it tests both packages:
//! `cargo test --release -p wm_bridge -p wm_bridge_peer`.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

mod cyclone_node;
#[path = "../../../bridge/tests/processes/harness.rs"]
#[allow(dead_code, reason = "the tests of wm_bridge need more of it")]
mod harness;
mod pair;
mod ros2;
mod services;
mod topics;
