//! The monitor node: shows a live status line, and reports at the end how well the predictions matched the camera.
//!
//! It matches and scores with this crate; here are the wires and the live line. The report is written when the node
//! stops, for whatever reason.

mod live_line;
mod node;

pub use node::NODE;
