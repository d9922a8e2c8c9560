//! A way to plan.

use std::fmt::Debug;

use crate::{PlanError, PlannedActions, Problem, Watch};

/// A way to plan. Equal problems and seeds give equal plans.
pub trait Planner: Debug + Send + Sync {
    /// Its name, as in `Plan.planner`.
    fn name(&self) -> &'static str;

    /// Finds actions for `problem`. `watch` is told of the progress, and can end the search: there is a plan all the same
    /// once a batch of candidates was tried.
    ///
    /// # Errors
    /// [`PlanError::Setting`] where the problem cannot be, [`PlanError::NoFiniteCost`], and the model's own.
    fn plan(
        &self,
        problem: &mut Problem<'_>,
        seed: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError>;
}
