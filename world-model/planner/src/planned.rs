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
    /// Other good plans, the best first, for the next search to begin from as well; iCEM alone keeps some.
    pub elites: Vec<Vec<Vec<f32>>>,
    /// How many candidates were rolled out.
    pub candidates: usize,
    /// How many of those had no finite cost and were left out.
    pub rejected: usize,
    /// Whether the search was ended before its last iteration was complete.
    pub deadline_cut: bool,
}

impl PlannedActions {
    /// What is left of the plan, and of its elites, when the first `passed` steps are over, going on with the last one: what
    /// the next search begins from. None where nothing is left.
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

    /// Plans to begin from, this one first.
    pub fn proposals(&self) -> Vec<Vec<Vec<f32>>> {
        std::iter::once(&self.actions)
            .chain(&self.elites)
            .cloned()
            .collect()
    }
}
