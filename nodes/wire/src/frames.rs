//! Coordinate frames from tf (REP 105): the tree of `/tf` and `/tf_static`, and conversion of poses. Pure: stamps come
//! from the messages.

pub mod pose;
mod tree;

pub use tree::{Frames, LookupError, TransformError, bare};
