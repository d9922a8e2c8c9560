//! Cost of a long way from the end of a plan to the goal.

use std::sync::Arc;

use candle_core::Tensor;
use wm_zoo::distance::TrainedDistance;

use super::Term;
use crate::{PlanError, SearchSpace};

/// Model steps from a plan's last latent to the goal, by a learnt distance: the median.
#[derive(Clone, Debug)]
pub struct StepsToGoal {
    distance: Arc<TrainedDistance>,
    /// (h, w, C), normalised.
    goal: Tensor,
}

impl StepsToGoal {
    /// The term for a goal (h, w, C), normalised.
    pub fn new(distance: Arc<TrainedDistance>, goal: Tensor) -> Self {
        Self { distance, goal }
    }
}

impl Term for StepsToGoal {
    fn name(&self) -> &'static str {
        "steps"
    }

    fn costs(
        &self,
        _: &SearchSpace,
        _: &[Vec<f32>],
        latents: &Tensor,
    ) -> Result<Vec<f32>, PlanError> {
        let last = latents.dim(1)?.saturating_sub(1);
        let last = latents.narrow(1, last, 1)?.squeeze(1)?;
        steps_to_goal(&self.distance, &last, &self.goal)
    }
}

/// Model steps from each latent (N, h, w, C) to `goal` (h, w, C) by a learnt distance: the median.
pub(crate) fn steps_to_goal(
    distance: &TrainedDistance,
    latents: &Tensor,
    goal: &Tensor,
) -> Result<Vec<f32>, PlanError> {
    let goals = goal.unsqueeze(0)?.broadcast_as(latents.shape())?;
    let pairs = Tensor::stack(&[latents, &goals], 1)?;
    let quantiles = distance.steps(&pairs).map_err(wm_model::Error::from)?;
    let median = |steps: Vec<f64>| {
        steps
            .get(steps.len() / 2)
            .map_or(f32::NAN, |steps| *steps as f32)
    };
    Ok(quantiles.into_iter().map(median).collect())
}
