//! The interface of all planners.

use std::fmt::Debug;

use crate::{PlanError, PlannedActions, Problem, Watch};

/// A planning method. Equal problems and seeds give equal plans.
pub trait Planner: Debug + Send + Sync {
    /// Name, as in `Plan.planner`.
    fn name(&self) -> &'static str;

    /// Finds actions for `problem`. `watch` receives the progress and can end the search; a plan exists as soon as one
    /// batch was rolled out.
    ///
    /// # Errors
    /// [`PlanError::Setting`] for an invalid problem, [`PlanError::NoFiniteCost`], and those of the model.
    fn plan(
        &self,
        problem: &mut Problem<'_>,
        seed: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError>;
}
