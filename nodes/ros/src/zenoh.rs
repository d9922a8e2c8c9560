//! Zenoh sessions of the suite's programs: one set of options, with defaults that reach only named hosts. Used by
//! `wm_bridge` and `wm_planner_worker`.

mod network;

pub use network::{Mode, NetworkArguments, open};
