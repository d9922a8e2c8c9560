//! The usual objective, by weights.

use candle_core::Tensor;
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
    /// The objective of a plan to `goals`, one latent (h, w, C) per model step, within `mask` (h, w). Without goals,
    /// the action terms alone.
    ///
    /// # Errors
    /// Latents of different shapes, or a mask that [`GoalDistance::within`] rejects.
    pub fn objective(
        &self,
        goals: &[Tensor],
        mask: Option<&Tensor>,
    ) -> Result<Objective, PlanError> {
        let within = |distance: GoalDistance| match mask {
            Some(mask) => distance.within(mask),
            None => Ok(distance),
        };
        let mut objective = Objective::default();
        if let Some(last) = goals.last() {
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

/// The goals of `horizon` model steps, one per step; the last one repeats.
pub fn one_per_step(goals: &[Tensor], horizon: usize) -> Vec<Tensor> {
    let last = goals.last();
    let of_step = |step| goals.get(step).or(last).cloned();
    (0..horizon).filter_map(of_step).collect()
}
