//! What is told of findings: that it can be read back, that nothing is lost, and that no text becomes markup.

#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod compared;
mod machine;
mod reading;
mod report;
mod sample;
