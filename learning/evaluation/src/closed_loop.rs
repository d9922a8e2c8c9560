//! How often planning succeeds (`wm eval control --task`): a simulated arm, a goal, and a planner that sees pictures only.
//!
//! An [`Actor`](actor::Actor) acts in a [`wm_sim::Environment`], one model step after the other, until the goal is attained
//! or the steps are over. Besides the planners there are the simulator's own controller (`oracle`), what needs no model
//! (`hold`, `random`), and the same planners with the simulator as a perfect model: what is lost to the model, and what to
//! the cost and the search.

pub(crate) mod actor;
mod arguments;
mod controller;
mod findings;
mod live;
pub(crate) mod model;
pub(crate) mod seeds;
mod settings;
mod simulator;
pub(crate) mod trial;

#[cfg(test)]
mod tests;

pub use arguments::ClosedLoopArgs;
