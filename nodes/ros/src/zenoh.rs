//! Zenoh sessions of the suite's programs: one set of options, and defaults that reach nobody whom the user has not named.
//! What is sent over them is not here: `wm_bridge`, `wm_planner_worker`.

mod network;

pub use network::{Mode, NetworkArguments, open};
