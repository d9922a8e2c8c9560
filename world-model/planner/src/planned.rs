//! The result of a plan.

/// The result of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedActions {
    /// One action per model step in model units, within all limits: (k, searched values).
    pub actions: Vec<Vec<f32>>,
    /// Cost of [`Self::actions`].
    pub cost: f32,
    /// Weighted terms of that cost, in the objective's order.
    pub terms: Vec<f32>,
    /// Least cost among the candidates of each iteration.
    pub iteration_costs: Vec<f32>,
    /// Other good plans, best first, as proposals for the next search; only iCEM has some.
    pub elites: Vec<Vec<Vec<f32>>>,
    /// Candidates rolled out.
    pub candidates: usize,
    /// Candidates without a finite cost.
    pub rejected: usize,
    /// Whether the search ended early.
    pub deadline_cut: bool,
}

impl PlannedActions {
    /// The plan and its elites after the first `passed` steps, extended with the last action: the proposals of the next
    /// search. `None` if no step is left.
    pub fn without(&self, passed: usize) -> Option<Self> {
        let left = |actions: &Vec<Vec<f32>>| -> Option<Vec<Vec<f32>>> {
            let left = actions.get(passed..)?;
            let last = left.last()?;
            let going_on = std::iter::repeat_n(last, passed);
            Some(left.iter().chain(going_on).cloned().collect())
        };
        Some(Self {
            actions: left(&self.actions)?,
            elites: self.elites.iter().filter_map(left).collect(),
            ..self.clone()
        })
    }

    /// Proposals for the next search, this plan first.
    pub fn proposals(&self) -> Vec<Vec<Vec<f32>>> {
        std::iter::once(&self.actions)
            .chain(&self.elites)
            .cloned()
            .collect()
    }
}
