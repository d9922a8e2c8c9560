//! Success rate of planning (`wm eval control --task`): a simulated arm, a goal, and a planner that sees only pictures.
//!
//! An [`Actor`](actor::Actor) acts in a [`wm_sim::Environment`], step by step, until the goal is reached or the steps
//! are over. Beside the planners there are the simulator's own controller (`oracle`), controllers without a model
//! (`hold`, `random`), and the planners with the simulator as a perfect model, which separates losses of the model from
//! those of cost and search.

pub(crate) mod actor;
mod arguments;
mod controller;
mod findings;
mod live;
pub(crate) mod model;
mod run;
pub(crate) mod seeds;
mod settings;
mod simulator;
pub(crate) mod trial;

#[cfg(test)]
mod tests;

pub use arguments::ClosedLoopArgs;
