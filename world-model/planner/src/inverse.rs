//! Plans with an inverse dynamics model.

use std::sync::Arc;

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_zoo::idm::TrainedIdm;

use crate::{PlanError, PlannedActions, Planner, Problem, Watch, search::Search};

/// The path of latents whose actions an inverse dynamics model infers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Path {
    /// At each step anew, from the imagined latent to the goal.
    #[default]
    Imagined,
    /// Along the straight line from the observed latent to the goal, in equal parts.
    Line,
}

/// Settings of the inverse planner.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InverseSettings {
    /// The path whose actions are inferred.
    pub path: Path,
}

/// Infers the actions to a goal with an inverse dynamics model of one model step: one forward pass per step, and one
/// rollout for the cost. It does not search, so it needs no seed. Goals must be latents.
#[derive(Clone)]
pub struct InversePlanner {
    idm: Arc<TrainedIdm>,
    settings: InverseSettings,
    /// Goals (h, w, C) by step; the last one is for all later steps.
    goals: Vec<Tensor>,
}

impl std::fmt::Debug for InversePlanner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InversePlanner")
            .field("settings", &self.settings)
            .field("goals", &self.goals.len())
            .finish_non_exhaustive()
    }
}

impl InversePlanner {
    /// Plans to `goals`, latents (h, w, C) in order, one per step; the last one is for all later steps.
    ///
    /// # Errors
    /// [`PlanError::Setting`] if the model infers several steps at once, or `goals` is empty.
    pub fn new(
        idm: Arc<TrainedIdm>,
        settings: InverseSettings,
        goals: Vec<Tensor>,
    ) -> Result<Self, PlanError> {
        let steps = idm.idm().horizon();
        if steps != 1 {
            return Err(PlanError::Setting(format!(
                "expected an inverse dynamics model of one step, got {steps} steps"
            )));
        }
        if goals.is_empty() {
            return Err(PlanError::Setting(
                "an inverse dynamics model needs a goal".into(),
            ));
        }
        Ok(Self {
            idm,
            settings,
            goals,
        })
    }

    /// Infers the actions (k, searched values), within the limits.
    pub(crate) fn infer(&self, problem: &mut Problem<'_>) -> Result<Vec<Vec<f32>>, PlanError> {
        let observed = problem.dynamics.start()?;
        let mut from = observed.clone();
        let mut inferred: Vec<f32> = Vec::new();
        for step in 0..problem.horizon {
            let goal = self.goals.get(step).or(self.goals.last());
            let Some(goal) = goal else { break };
            let (before, to) = match self.settings.path {
                Path::Imagined => (from.clone(), goal.clone()),
                Path::Line => {
                    // A plan has few steps: exact in f64.
                    let at = |step: usize| -> Result<Tensor, PlanError> {
                        let share = step as f64 / problem.horizon as f64;
                        Ok(((&observed * (1.0 - share))? + (goal * share)?)?)
                    };
                    (at(step)?, at(step + 1)?)
                }
            };
            let pair = Tensor::stack(&[&before, &to], 0)?.unsqueeze(0)?;
            let action = self
                .idm
                .idm()
                .forward(&pair)
                .map_err(wm_model::Error::from)?;
            let action = action.flatten_all()?.to_vec1::<f32>()?;
            inferred.extend(problem.space.searched(&action));
            inferred = problem.space.limit(inferred);
            let is_last = step + 1 == problem.horizon;
            if self.settings.path == Path::Imagined && !is_last {
                let latents = problem.rollout(std::slice::from_ref(&inferred))?;
                from = latents.get(0)?.get(step)?;
            }
        }
        let values = problem.space.len();
        Ok(inferred.chunks_exact(values).map(<[f32]>::to_vec).collect())
    }
}

impl Planner for InversePlanner {
    fn name(&self) -> &'static str {
        "idm"
    }

    fn plan(
        &self,
        problem: &mut Problem<'_>,
        _: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError> {
        let inferred = self.infer(problem)?;
        let mut search = Search::new(problem, watch)?;
        search.iterate(vec![inferred.concat()])?;
        search.finish(None)
    }
}
