//! Trainings, and the program wm-training.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod command_line;
mod evaluation;
mod fit;
#[path = "../../../learning/import/tests/shared_data/folder.rs"]
mod folder;
mod imported;
mod long_recording;
mod taef2_on_bridge;
