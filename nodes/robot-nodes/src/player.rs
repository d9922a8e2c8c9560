//! The player node: publishes a bag's messages with their recorded timing, their bytes unchanged.
//!
//! On request it also publishes the next actions ([`chunks`]), as a policy would on a robot, and the bag's last frame
//! as the planner's goal ([`wm_camera::goal`]). Pure steps compute both from the bag.
//!
//! Time: with `restamp`, header stamps are shifted from the bag's time to the present ([`restamp`], [`playback`]), in
//! place, so that latencies are those of live data. Without it they are unchanged, and `clock` publishes the bag's time
//! on `/clock` for nodes with `use_sim_time`. Either way the messages keep their intervals, divided by `rate`.
//!
//! Keys and the services of rosbag2's player pause the playback, and change its rate and its time in the bag.
//!
//! Bags are read by `wm_bag`.

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
