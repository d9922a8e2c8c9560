//! The usual objective, by weights.

use candle_core::{Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::{ActionSize, GoalDistance, Objective, PlanError, Smoothness, Target};

/// Weights of the usual terms; 0 drops a term.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Weights {
    /// Distance to the goal after the last step.
    pub goal: f32,
    /// Mean distance over all steps, each to its own goal.
    pub path: f32,
    /// Size of the actions.
    pub action: f32,
    /// Change from one action to the next.
    pub smoothness: f32,
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            goal: 1.0,
            path: 0.0,
            action: 0.0,
            smoothness: 0.0,
        }
    }
}

impl Weights {
    /// The objective of a plan that is to be at `goals`, one latent (h, w, C) a model step, where `mask` (h, w; row-major) is
    /// above 0, if there is one. Without goals, the terms of the actions alone.
    ///
    /// # Errors
    /// Latents of different shapes, or a mask that [`GoalDistance::within`] rejects.
    pub fn objective(
        &self,
        goals: &[Tensor],
        mask: Option<&[f32]>,
    ) -> Result<Objective, PlanError> {
        let mut objective = Objective::default();
        if let Some(last) = goals.last() {
            let (height, width, _) = last.dims3()?;
            let mask = mask.map(|mask| Tensor::from_slice(mask, (height, width), &Device::Cpu));
            let mask = mask.transpose()?;
            let within = |distance: GoalDistance| match &mask {
                Some(mask) => distance.within(mask),
                None => Ok(distance),
            };
            let each = Target::EachStep(Tensor::stack(goals, 0)?);
            let last = Target::LastStep(last.clone());
            objective = objective
                .and(self.goal, within(GoalDistance::new(last))?)
                .and(self.path, within(GoalDistance::new(each).named("path"))?);
        }
        Ok(objective
            .and(self.action, ActionSize)
            .and(self.smoothness, Smoothness))
    }
}
