//! The trials node: has the simulated arm do its tasks, and counts how often the planner succeeds.
//!
//! It sets the table (`sim_arm`), arms the executor, and watches: what the camera saw, what the planner imagined, and
//! whether the task was done in time. An [`EpisodeWatch`] is what it knows of an episode, with neither DDS nor a clock.

mod files;
mod node;
mod setting;
mod shots;
mod strip;
mod watch;

pub use node::NODE;
pub use shots::{Shot, Shots};
pub use watch::EpisodeWatch;
