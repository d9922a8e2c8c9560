//! What a search found.

/// What a search found.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedActions {
    /// One action a model step, in model units, within all limits: (k, searched values).
    pub actions: Vec<Vec<f32>>,
    /// Cost of [`Self::actions`].
    pub cost: f32,
    /// What each term of the objective has in it, weighted, in the objective's order.
    pub terms: Vec<f32>,
    /// Least cost among the candidates of each iteration.
    pub iteration_costs: Vec<f32>,
    /// How many candidates were rolled out.
    pub candidates: usize,
    /// How many of those had no finite cost and were left out.
    pub rejected: usize,
    /// Whether the search was ended before its last iteration was complete.
    pub deadline_cut: bool,
}

impl PlannedActions {
    /// What is left of the plan when its first `passed` steps are over, going on with the last one: the proposal to start
    /// the next search from. None where nothing is left.
    pub fn without(&self, passed: usize) -> Option<Self> {
        let left = self.actions.get(passed..)?;
        let last = left.last()?;
        let going_on = std::iter::repeat_n(last, passed);
        let actions = left.iter().chain(going_on).cloned().collect();
        Some(Self {
            actions,
            ..self.clone()
        })
    }
}
