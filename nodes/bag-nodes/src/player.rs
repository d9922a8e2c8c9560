//! The player node: a bag's messages at the times at which they were recorded, their bytes untouched.
//!
//! Two things can be added for the other nodes, computed by pure steps over the bag: the actions that are to come
//! ([`chunks`]), which a policy would send on a robot, and the bag's last frame as goal for the planner ([`wm_camera::goal`]).
//!
//! Time: with `restamp`, header stamps are moved from the bag's time to now ([`restamp`], [`playback`]), in place,
//! so that latencies are those of live data; without it they stay, and `clock` publishes the bag's time on `/clock`
//! for nodes with `use_sim_time`. Either way the messages keep their distances, divided by `rate`.
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
pub use node::{NODE, body, run};
pub use settings::{Parameters, Settings};
