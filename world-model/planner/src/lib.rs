//! Plans actions that bring the camera's view to a goal.
//!
//! A [`Problem`] consists of a [`SearchSpace`], the [`Dynamics`] and an [`Objective`] (a sum of named terms). A
//! [`Planner`] solves it: [`Cem`], [`Icem`] and [`Mppi`] search, [`InversePlanner`] uses an inverse dynamics model, and
//! [`SeededSearch`] searches from its actions. Planners own no model, clock or robot. One seed gives one plan, whatever
//! the batch size and the number of threads.
//!
//! [`TransitionDynamics`] makes the transition model the dynamics; all candidates share one cached context and one
//! noise. [`Workers`], processes with the same model, cost part of the batches with a [`CostFunction`]. All values are
//! in model units; `wm_motion::actions::ActionEncoding` converts a plan to metres and radians.

mod array;
mod cem;
mod choice;
mod cost_function;
mod dynamics;
mod error;
mod fingerprint;
mod goals;
mod icem;
mod inverse;
mod mppi;
mod objective;
mod planned;
mod planner;
mod problem;
mod proposal;
mod search;
mod seeded;
mod space;
mod spread;
mod subgoals;
mod transition_dynamics;
mod waypoint;
mod weights;
mod workers;
mod workspace;

#[cfg(test)]
mod testing;

pub use array::Array;
pub use cem::{Cem, CemSettings, Returned};
pub use choice::{PlannerChoice, PlannerSettings};
pub use cost_function::{CostFunction, Evaluator};
pub use dynamics::Dynamics;
pub use error::PlanError;
pub use fingerprint::fingerprint;
pub use goals::{Goals, one_per_step};
pub use icem::{Icem, IcemSettings};
pub use inverse::{InversePlanner, InverseSettings, Path};
pub use mppi::{Mppi, MppiSettings};
pub use objective::{
    ActionSize, Costs, GoalDistance, Objective, PortableTerm, Smoothness, StepsToGoal, Success,
    Target, Term, WorkspaceMargin,
};
pub use planned::PlannedActions;
pub use planner::Planner;
pub use problem::{Problem, Progress, Watch};
pub use seeded::SeededSearch;
pub use space::{Coordinate, Range, SearchSpace};
pub use spread::spread;
pub use subgoals::Subgoals;
pub use transition_dynamics::TransitionDynamics;
pub use waypoint::{Arrival, Waypoint, goals_by_time};
pub use weights::Weights;
pub use workers::{Batch, Turn, WorkerCounts, WorkerPool, Workers};
pub use workspace::{Workspace, WorkspaceAxis};
