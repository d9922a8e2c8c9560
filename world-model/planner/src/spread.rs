//! Uncertainty of a plan's cost.

use candle_core::{Device, Tensor};

use crate::{Objective, PlanError, SearchSpace, TransitionDynamics};

/// Costs of one plan (k, searched values), one for each of the sampler's noise `seeds`. A wide spread means an
/// uncertain prediction.
///
/// # Errors
/// If the plan does not fit the model, or the model fails.
/// Where the plan does not fit the model, or the model fails.
pub fn spread(
    dynamics: &TransitionDynamics<'_>,
    objective: &Objective,
    space: &SearchSpace,
    plan: &[Vec<f32>],
    seeds: &[u64],
) -> Result<Vec<f32>, PlanError> {
    let whole: Vec<f32> = plan.iter().flat_map(|action| space.whole(action)).collect();
    let shape = (1, plan.len(), space.action_dim());
    let actions = Tensor::from_vec(whole, shape, &Device::Cpu)?;
    let latents = dynamics.rollout_under(&actions, seeds)?;
    let candidates = vec![plan.concat(); seeds.len()];
    Ok(objective.costs(space, &candidates, &latents)?.total)
}
