//! Suites over whole models, networks in ONNX, and judges.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod networks;
mod perception;
mod protocol;
