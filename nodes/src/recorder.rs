//! The recorder node: topics into a bag, their bytes untouched.
//!
//! Topics are found as they appear ([`selection`]), each is subscribed with the quality of service that its
//! publishers offer, and its definition comes from this suite or from the ROS packages on `AMENT_PREFIX_PATH`
//! ([`definitions`]). The bag is written on a thread of its own, chunk by chunk: a killed recorder loses at most
//! the open chunk. Whatever finds no room on the way is counted, topic by topic, and reported at the end.
//!
//! Not here: the bag's format (`wm_bag`); splitting by size, snapshots.

pub mod definitions;
mod node;
pub mod selection;
mod writer;

pub use node::{NAME, run};
