//! Tests of whole processes: the suite as a user runs it, with a real ROS 2 as its peer.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

mod actions;
mod arm;
mod bags;
mod browser;
mod cyclone;
mod determinism;
mod docs;
mod doctor;
mod exit_codes;
mod faults;
mod foxglove;
mod fresh_domain;
mod gym;
mod harness;
mod interop;
#[cfg(feature = "zenoh")]
mod keys;
mod learner;
mod lyrical;
mod output;
mod packages;
mod policy;
mod policy_servers;
mod replay;
mod ros2_peer;
mod view;
mod view_clients;
mod view_process;
mod viewers;
mod views;
mod websocket;
#[cfg(feature = "zenoh")]
mod zenoh_hosts;
#[cfg(feature = "zenoh")]
mod zenoh_router;
