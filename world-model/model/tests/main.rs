//! The networks against PyTorch.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod autoencoder_parity;
mod transition_parity;
