//! The monitor node: shows a live status line, and reports at the end how well the predictions matched the camera.
//!
//! It connects topics with this crate's scorer. It always writes the report when it stops.

mod live_line;
mod node;

pub use node::NODE;
