//! CDR, definitions and type hashes.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod cdr;
mod definitions;
