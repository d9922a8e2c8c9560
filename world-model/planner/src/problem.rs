//! What is to be planned.

use candle_core::{Device, Tensor};

use crate::{Costs, Dynamics, Objective, PlanError, SearchSpace, Workers};

/// What is to be planned.
pub struct Problem<'a> {
    /// What may be chosen.
    pub space: &'a SearchSpace,
    /// What comes of it.
    pub dynamics: &'a mut dyn Dynamics,
    /// What that costs.
    pub objective: &'a Objective,
    /// Model steps k of a plan, at least 1.
    pub horizon: usize,
    /// Most candidates rolled out at once: bounds memory, is how often [`Watch`] is asked, and what a worker is given.
    pub batch: usize,
    /// Plans to begin from, the most promising first: one searched action a step, (k, values) each. Usually what is left
    /// of the last plan.
    pub proposals: Vec<Vec<Vec<f32>>>,
    /// Others who cost batches of candidates too. The plan is the same without them.
    pub workers: Option<&'a mut (dyn Workers + 'static)>,
}

/// How far a search is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// The iteration that goes on, from 1.
    pub iteration: usize,
    /// Candidates rolled out so far.
    pub candidates: usize,
    /// The least cost so far; `None` before the first finite one.
    pub best: Option<f32>,
    /// Terms of that cost, in the order of the objective's, weighted.
    pub terms: &'a [f32],
    /// Standard deviation of the newest batch's finite costs; 0 for fewer than two.
    pub deviation: f32,
}

/// Asked before each batch of candidates but the first; `true` ends the search.
pub type Watch<'w> = &'w mut dyn FnMut(&Progress<'_>) -> bool;

impl Problem<'_> {
    /// Whether the numbers can serve.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names what cannot.
    pub(crate) fn validate(&self) -> Result<(), PlanError> {
        let complain = |text: String| Err(PlanError::Setting(text));
        if self.horizon == 0 || self.batch == 0 {
            return complain("horizon and batch must be at least 1".into());
        }
        let (needed, given) = (self.dynamics.action_dim(), self.space.action_dim());
        if needed != given {
            return complain(format!(
                "the model's actions have {needed} values, those of the search space {given}"
            ));
        }
        let (horizon, values) = (self.horizon, self.space.len());
        for proposal in &self.proposals {
            if proposal.len() != horizon || proposal.iter().any(|action| action.len() != values) {
                return complain(format!(
                    "a proposal must be {horizon} actions of {values} values, not {} of {:?}",
                    proposal.len(),
                    proposal.first().map(Vec::len)
                ));
            }
            if proposal.iter().flatten().any(|value| !value.is_finite()) {
                return complain("a proposal holds a value that is not finite".into());
            }
        }
        Ok(())
    }

    /// Costs of candidates, each of horizon x values, which the limits have been applied to.
    pub(crate) fn costs(&mut self, candidates: &[Vec<f32>]) -> Result<Costs, PlanError> {
        let latents = self.rollout(candidates)?;
        self.objective.costs(self.space, candidates, &latents)
    }

    /// The latent to which the actions of a plan, horizon x searched values, lead: row-major, channels last.
    ///
    /// # Errors
    /// If the model cannot compute it, or the plan has no action.
    pub fn outcome(&mut self, actions: &[Vec<f32>]) -> Result<Vec<f32>, PlanError> {
        let latents = self.rollout(&[actions.concat()])?.squeeze(0)?;
        let last = latents.dim(0)?.saturating_sub(1);
        Ok(latents.narrow(0, last, 1)?.flatten_all()?.to_vec1()?)
    }

    /// Latents (N, k, h, w, C) that candidates lead to.
    pub(crate) fn rollout(&mut self, candidates: &[Vec<f32>]) -> Result<Tensor, PlanError> {
        let values = self.space.len();
        let data: Vec<f32> = candidates
            .iter()
            .flat_map(|candidate| candidate.chunks_exact(values))
            .flat_map(|action| self.space.whole(action))
            .collect();
        let steps = candidates
            .first()
            .map_or(self.horizon, |first| first.len() / values);
        let shape = (candidates.len(), steps, self.space.action_dim());
        let actions = Tensor::from_vec(data, shape, &Device::Cpu)?;
        Ok(self.dynamics.rollout(&actions)?)
    }
}
