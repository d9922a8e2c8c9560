//! LeRobot data sets: round trips, independent readers and writers, and damage.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the lint exempts #[test] functions, not their helpers

mod damage;
mod derived;
mod gaps;
mod made;
mod peers;
mod round_trip;
