//! The monitor node: what is happening in one live line, and at the end how well the predictions came true.
//!
//! It matches and scores with this crate; here are the wires and the live line. The report is written when the
//! node is stopped, however that comes.

mod live_line;
mod node;

pub use node::{NODE, run};
