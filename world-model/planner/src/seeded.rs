//! Searching from what another planner found.

use crate::{Inverse, PlanError, PlannedActions, Planner, Problem, Watch};

/// A search that begins from what an inverse dynamics model tells, and tries what is left of the last plan besides.
#[derive(Debug)]
pub struct Seeded {
    name: &'static str,
    inverse: Inverse,
    search: Box<dyn Planner>,
}

impl Seeded {
    /// The search under a `name` such as `idm+icem`.
    pub fn new(name: &'static str, inverse: Inverse, search: Box<dyn Planner>) -> Self {
        Self {
            name,
            inverse,
            search,
        }
    }
}

impl Planner for Seeded {
    fn name(&self) -> &'static str {
        self.name
    }

    fn plan(
        &self,
        problem: &mut Problem<'_>,
        seed: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError> {
        let told = self.inverse.tell(problem)?;
        problem.proposals.insert(0, told);
        self.search.plan(problem, seed, watch)
    }
}
