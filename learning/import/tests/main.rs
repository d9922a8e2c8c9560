//! Imports and exports of robot data sets, and the program wm-datasets.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod audit_shared_data;
mod exit_codes;
#[path = "shared_data/folder.rs"]
mod folder;
mod lerobot;
mod shared_data;
mod video;
