//! The model nodes over real DDS on loopback.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod calibration;
mod camera_faults;
mod fit;
#[path = "../../../tests/fresh_domain.rs"]
mod fresh_domain;
mod latent_spaces;
mod model_change;
mod running;
mod sim_time;
mod slow_model;
mod wire;
