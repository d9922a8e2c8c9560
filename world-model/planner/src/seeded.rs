//! Searches from the actions of an inverse dynamics model.

use crate::{InversePlanner, PlanError, PlannedActions, Planner, Problem, Watch};

/// A search whose first proposal comes from an inverse dynamics model, followed by the rest of the last plan.
#[derive(Debug)]
pub struct SeededSearch {
    name: &'static str,
    inverse: InversePlanner,
    search: Box<dyn Planner>,
}

impl SeededSearch {
    /// `name` as in parameters, such as `idm+icem`.
    pub fn new(name: &'static str, inverse: InversePlanner, search: Box<dyn Planner>) -> Self {
        Self {
            name,
            inverse,
            search,
        }
    }
}

impl Planner for SeededSearch {
    fn name(&self) -> &'static str {
        self.name
    }

    fn plan(
        &self,
        problem: &mut Problem<'_>,
        seed: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError> {
        let inferred = self.inverse.infer(problem)?;
        problem.proposals.insert(0, inferred);
        self.search.plan(problem, seed, watch)
    }
}
