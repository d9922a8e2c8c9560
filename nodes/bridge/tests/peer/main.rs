//! `wm-bridge` and the real zenoh-bridge-ros2dds (`wm-bridge-peer`), each with a domain of its own. Also
//! nodes of wm over Zenoh with hiroz and with zenoh-ros2-sdk, which speak the wire format of rmw_zenoh.
//!
//! `cargo test --release -p wm_bridge --features peer`; with `--features hiroz` only the latter.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

#[cfg(feature = "peer")]
mod cyclone_node;
#[path = "../../../../tests/fresh_domain.rs"]
mod fresh_domain;
#[path = "../processes/harness.rs"]
#[allow(dead_code, reason = "the tests without this peer need more of it")]
mod harness;
mod hiroz_nodes;
mod hiroz_types;
#[cfg(feature = "peer")]
mod pair;
#[cfg(feature = "peer")]
mod ros2;
#[path = "../../../../tests/ros2_peer.rs"]
#[allow(dead_code, reason = "other tests need more of it")]
mod ros2_peer;
mod sdk_nodes;
#[cfg(feature = "peer")]
mod services;
#[cfg(feature = "peer")]
mod topics;
mod zenoh_process;
