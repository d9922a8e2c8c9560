//! Figures and statistics against published numbers and other implementations.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod findings;
mod paper;
mod parity;
