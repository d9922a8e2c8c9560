//! The player node: publishes a bag's messages with their recorded timing, their bytes unchanged.
//!
//! It can add two things for the other nodes, computed by pure steps over the bag: the next actions ([`chunks`]), which
//! a policy would send on a robot, and the bag's last frame as the planner's goal ([`wm_camera::goal`]).
//!
//! Time: with `restamp`, header stamps are shifted from the bag's time to the present ([`restamp`], [`playback`]), in
//! place, so that latencies are those of live data. Without it they are unchanged, and `clock` publishes the bag's time
//! on `/clock` for nodes with `use_sim_time`. Either way the messages keep their intervals, divided by `rate`.
//!
//! Keys and the services of rosbag2's player pause it, change its rate and its place in the bag.
//!
//! Not here: reading bags (`wm_bag`).

mod check;
pub mod chunks;
mod node;
pub mod playback;
mod playlist;
pub mod restamp;
mod settings;
mod source;

pub use check::check;
pub use node::NODE;
pub use settings::{Parameters, Settings};
