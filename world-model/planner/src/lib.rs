//! Planning: which actions bring what the camera sees to a goal.
//!
//! A [`Problem`] says what may be chosen ([`SearchSpace`]), what comes of it ([`Dynamics`]) and what that costs
//! ([`Objective`], a sum of named terms). A [`Planner`] solves it: [`Cem`], [`Icem`] and [`Mppi`] search, [`Inverse`] asks an
//! inverse dynamics model, and [`Seeded`] searches from what another found. None of them holds a model, a clock or a
//! robot; one seed gives one plan, whatever the size of the batches and the number of threads.
//!
//! The transition model serves as the dynamics by [`TransitionDynamics`], which shares one cached context and one noise
//! among all candidates. [`Workers`], processes with the same model, may cost some of the batches; a [`CostFunction`] is all
//! that they need for it. Everything here is in model units; `wm_motion::actions::ActionEncoding` turns a plan into metres
//! and radians.

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
pub use goals::{Goals, one_a_step};
pub use icem::{Icem, IcemSettings};
pub use inverse::{Inverse, InverseSettings, Path};
pub use mppi::{Mppi, MppiSettings};
pub use objective::{
    ActionSize, Costs, GoalDistance, Objective, PortableTerm, Smoothness, Success, Target, Term,
    WorkspaceMargin,
};
pub use planned::PlannedActions;
pub use planner::Planner;
pub use problem::{Problem, Progress, Watch};
pub use seeded::Seeded;
pub use space::{Coordinate, Range, SearchSpace};
pub use spread::spread;
pub use transition_dynamics::TransitionDynamics;
pub use waypoint::{Arrival, Waypoint, timed};
pub use weights::Weights;
pub use workers::{Batch, Turn, WorkerCounts, WorkerPool, Workers};
pub use workspace::{Workspace, WorkspaceAxis};
