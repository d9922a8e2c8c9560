//! The recorder node: records topics into a bag, their bytes unchanged.
//!
//! Topics are found as they appear ([`selection`]), each is subscribed with the quality of service that its publishers
//! offer, and its definition comes from this suite or from the ROS packages on `AMENT_PREFIX_PATH` ([`wm_bag::definitions`]),
//! else from a live publisher (`lookup`).
//! The bag is written on a separate thread, chunk by chunk: a killed recorder loses at most the open chunk. Messages
//! that are missing from the bag are counted by topic and cause, and reported at the end (`losses`).
//!
//! Keys and the services of rosbag2's recorder pause it, split its bag, close it and begin another. The module `place`
//! decides where bags may be made, so that no peer's request replaces a bag. In snapshot mode the recorder keeps the latest
//! messages and writes them on request.
//!
//! Not here: the bag's format (`wm_bag`).

pub mod definitions;
mod lookup;
mod losses;
mod node;
mod options;
mod place;
pub mod selection;
mod writer;

pub use node::NODE;
