//! The trials node: runs tasks on the simulated arm, and counts how often the planner succeeds.
//!
//! It sets the table (`sim_arm`), arms the executor, and records what the camera saw, what the planner imagined, and
//! whether the task was done in time. An `EpisodeWatch` holds the state of an episode, without DDS or clock.

mod files;
mod node;
mod setting;
mod shots;
mod strip;
mod task;
mod watch;

pub use node::NODE;

use shots::{Imagined, Shots};
use watch::EpisodeWatch;
