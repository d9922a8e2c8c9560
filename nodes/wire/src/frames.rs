//! Coordinate frames in each other, as tf tells them (REP 105): the tree that `/tf` and `/tf_static` grow, and poses between
//! messages and values. Pure: stamps come from the messages.

pub mod pose;
mod tree;

pub use tree::{Frames, LeftOut, Unknown, bare};
