//! Bags written and read, here and by the tools of others.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod foreign_channels;
mod interop;
mod latched;
mod storages;
mod times;
