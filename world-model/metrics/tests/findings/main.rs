//! Outputs can be read back, lose nothing, and never turn text into markup.

#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod compared;
mod machine;
mod reading;
mod report;
mod sample;
