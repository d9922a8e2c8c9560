//! The cost of a plan: a sum of named terms.

mod action_size;
mod goal_distance;
mod portable_term;
mod smoothness;
mod steps_to_goal;
mod success;
mod workspace_margin;

use std::fmt::Debug;

use candle_core::Tensor;

pub use action_size::ActionSize;
pub use goal_distance::{GoalDistance, Target};
pub use portable_term::PortableTerm;
pub use smoothness::Smoothness;
pub use steps_to_goal::StepsToGoal;
pub(crate) use steps_to_goal::steps_to_goal;
pub use success::Success;
pub use workspace_margin::WorkspaceMargin;

use crate::{PlanError, SearchSpace};

/// A term of the cost, unweighted.
pub trait Term: Debug + Send + Sync {
    /// Its name, as in parameters and in `Plan.terms`.
    fn name(&self) -> &'static str;

    /// Costs of N candidates: `candidates` of steps x searched values within the limits of `space`, and their `latents`
    /// (N, k, h, w, C). A cost may be NaN or infinite where a latent is.
    ///
    /// # Errors
    /// If the latents do not fit, or a model fails.
    fn costs(
        &self,
        space: &SearchSpace,
        candidates: &[Vec<f32>],
        latents: &Tensor,
    ) -> Result<Vec<f32>, PlanError>;

    /// The term in serialisable form; `None` if it needs more than the transition model.
    ///
    /// # Errors
    /// If a tensor cannot be read.
    fn portable(&self) -> wm_model::Result<Option<PortableTerm>> {
        Ok(None)
    }
}

/// A weighted sum of terms.
#[derive(Debug, Default)]
pub struct Objective {
    terms: Vec<(f32, Box<dyn Term>)>,
}

/// Costs of candidates.
#[derive(Clone, Debug, PartialEq)]
pub struct Costs {
    /// Sum of the terms, by candidate.
    pub total: Vec<f32>,
    /// Weighted terms, by candidate, in the objective's order.
    pub terms: Vec<Vec<f32>>,
}

impl Costs {
    /// Costs from weighted `terms`.
    pub fn of_terms(terms: Vec<Vec<f32>>) -> Self {
        let total = terms.iter().map(|terms| terms.iter().sum()).collect();
        Self { total, terms }
    }
}

impl Objective {
    /// The distance to a goal alone: the objective of the controllability metric.
    pub fn of(target: Target) -> Self {
        Self::default().and(1.0, GoalDistance::new(target))
    }

    /// Adds a term with this weight; a weight of 0 drops it.
    #[must_use]
    pub fn and(mut self, weight: f32, term: impl Term + 'static) -> Self {
        if weight != 0.0 {
            self.terms.push((weight, Box::new(term)));
        }
        self
    }

    /// Names of the terms.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.terms.iter().map(|(_, term)| term.name())
    }

    /// The weighted terms in serialisable form.
    ///
    /// # Errors
    /// [`PlanError::NotPortable`] names a term without such a form.
    pub fn portable(&self) -> Result<Vec<(f32, PortableTerm)>, PlanError> {
        let portable = |(weight, term): &(f32, Box<dyn Term>)| {
            let portable = term.portable()?;
            let portable = portable.ok_or(PlanError::NotPortable { term: term.name() })?;
            Ok((*weight, portable))
        };
        self.terms.iter().map(portable).collect()
    }

    /// The objective of serialised terms, with their default names.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names an invalid number.
    pub fn of_portable(terms: &[(f32, PortableTerm)]) -> Result<Self, PlanError> {
        let weighted = |(weight, term): &(f32, PortableTerm)| {
            if !weight.is_finite() {
                let name = term.name();
                return Err(PlanError::Setting(format!(
                    "the weight of {name} must be finite, not {weight}"
                )));
            }
            Ok((*weight, term.build()?))
        };
        let terms = terms.iter().map(weighted).collect::<Result<_, _>>()?;
        Ok(Self { terms })
    }

    /// Costs of candidates; see [`Term::costs`].
    ///
    /// # Errors
    /// [`PlanError::Setting`] if there are no terms, and those of the terms.
    pub fn costs(
        &self,
        space: &SearchSpace,
        candidates: &[Vec<f32>],
        latents: &Tensor,
    ) -> Result<Costs, PlanError> {
        if self.terms.is_empty() {
            return Err(PlanError::Setting(
                "the objective has no terms: nothing to reach".into(),
            ));
        }
        let mut terms = vec![Vec::with_capacity(self.terms.len()); candidates.len()];
        for (weight, term) in &self.terms {
            let costs = term.costs(space, candidates, latents)?;
            if costs.len() != candidates.len() {
                return Err(PlanError::Setting(format!(
                    "the term {} gave {} costs for {} candidates",
                    term.name(),
                    costs.len(),
                    candidates.len()
                )));
            }
            for (terms, cost) in terms.iter_mut().zip(costs) {
                terms.push(weight * cost);
            }
        }
        Ok(Costs::of_terms(terms))
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn terms_are_weighted_and_zero_weights_dropped() {
        let space = SearchSpace::bounded(&[(-1.0, 1.0)], 1).unwrap();
        let latents =
            Tensor::zeros((2, 2, 1, 1, 1), candle_core::DType::F32, &Device::Cpu).unwrap();
        let goal = Tensor::ones((1, 1, 1), candle_core::DType::F32, &Device::Cpu).unwrap();
        let objective = Objective::of(Target::LastStep(goal))
            .and(0.5, ActionSize)
            .and(0.0, Smoothness);
        assert_eq!(objective.names().collect::<Vec<_>>(), ["goal", "action"]);
        let costs = objective
            .costs(&space, &[vec![0.0, 0.0], vec![1.0, -1.0]], &latents)
            .unwrap();
        assert_eq!(costs.terms, [[1.0, 0.0], [1.0, 0.5]]);
        assert_eq!(costs.total, [1.0, 1.5]);
        let nothing = Objective::default().costs(&space, &[vec![0.0, 0.0]], &latents);
        assert!(nothing.unwrap_err().to_string().contains("no terms"));
    }
}
