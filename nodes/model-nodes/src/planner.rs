//! The planner node: a goal, latents and actions in, plans out.
//!
//! [`PlannerStep`] is the node's state without its ROS interface: it keeps the goal and the history, and decides when
//! and from what to plan ([`PlanRequest`]). [`PlannerModel::plan`] computes a request by one of the planners of
//! `wm_planner`, with the node's own transition model: candidates never cross a topic.

mod action;
mod error;
mod goal;
mod markers;
mod model;
mod node;
mod parameters;
mod setup;
mod step;
mod workers;

pub use action::{ActionRun, Course, End, SearchProgress};
pub use error::PlannerError;
pub use goal::{Goal, GoalError, GoalReader};
pub use model::{Planned, PlannerModel, PlannerParts};
pub use node::NODE;
pub use setup::{MotionLimits, PlannerSetup, WorkspaceBox};
pub use step::{Lead, PlanRequest, PlanWait, PlannerSettings, PlannerStep, Unsent};
pub use workers::{ConnectWorkers, connect_workers_by};
