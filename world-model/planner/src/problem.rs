//! The input of a planner.

use candle_core::{Device, Tensor};

use crate::{Costs, Dynamics, Objective, PlanError, SearchSpace, Workers};

/// The input of a planner.
pub struct Problem<'a> {
    /// Values to choose, and their limits.
    pub space: &'a SearchSpace,
    /// Prediction of the latents.
    pub dynamics: &'a mut dyn Dynamics,
    /// Cost of candidates.
    pub objective: &'a Objective,
    /// Model steps k of a plan, at least 1.
    pub horizon: usize,
    /// Most candidates rolled out at once: bounds memory, the time between calls of [`Watch`], and the work sent to a
    /// worker.
    pub batch: usize,
    /// Plans to start from, the most promising first: (k, searched values) each. Usually the rest of the last plan.
    pub proposals: Vec<Vec<Vec<f32>>>,
    /// Workers that cost batches too. They do not change the plan.
    pub workers: Option<&'a mut (dyn Workers + 'static)>,
}

/// Progress of a search.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// The current iteration, from 1.
    pub iteration: usize,
    /// Candidates rolled out so far.
    pub candidates: usize,
    /// Least cost so far; `None` if none is finite yet.
    pub best: Option<f32>,
    /// Weighted terms of that cost, in the objective's order.
    pub terms: &'a [f32],
    /// Standard deviation of the newest batch's finite costs; 0 if fewer than two.
    pub deviation: f32,
}

/// Called at each batch of candidates except the first; `true` ends the search.
pub type Watch<'w> = &'w mut dyn FnMut(&Progress<'_>) -> bool;

impl Problem<'_> {
    /// Checks sizes and proposals.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first invalid part.
    pub(crate) fn validate(&self) -> Result<(), PlanError> {
        let complain = |text: String| Err(PlanError::Setting(text));
        if self.horizon == 0 || self.batch == 0 {
            return complain("horizon and batch must be at least 1".into());
        }
        let (needed, given) = (self.dynamics.action_dim(), self.space.action_dim());
        if needed != given {
            return complain(format!(
                "the model's actions have {needed} values, but those of the search space {given}"
            ));
        }
        let (horizon, values) = (self.horizon, self.space.len());
        for proposal in &self.proposals {
            if proposal.len() != horizon || proposal.iter().any(|action| action.len() != values) {
                return complain(format!(
                    "expected proposals of {horizon} actions of {values} values, got {} of {:?}",
                    proposal.len(),
                    proposal.first().map(Vec::len)
                ));
            }
            if proposal.iter().flatten().any(|value| !value.is_finite()) {
                return complain("a proposal has a value that is not finite".into());
            }
        }
        Ok(())
    }

    /// Costs of candidates, each of horizon x values, within the limits.
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

    /// Latents (N, k, h, w, C) of candidates.
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
