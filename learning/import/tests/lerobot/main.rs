//! LeRobot datasets there and back, against readers and writers that nobody here wrote, and damaged.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

mod damage;
mod gaps;
mod made;
mod peers;
mod round_trip;
