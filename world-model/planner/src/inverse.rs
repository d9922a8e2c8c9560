//! Asking an inverse dynamics model.

use std::sync::Arc;

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_zoo::idm::TrainedIdm;

use crate::{PlanError, PlannedActions, Planner, Problem, Watch, search::Search};

/// The way from the observed latent to the goal's, of which an inverse dynamics model tells the actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Path {
    /// The goal is asked for at each step anew, from the latent that the actions so far lead to in imagination.
    #[default]
    Imagined,
    /// Along the straight line from the observed latent to the goal's, in equal parts.
    Line,
}

/// Settings of the inverse planner.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InverseSettings {
    /// The way whose actions are told.
    pub path: Path,
}

/// Tells the actions to a goal by an inverse dynamics model of one model step: one forward pass a step, and one rollout
/// for the cost. It searches nothing, so it takes no seed; the goal must be a latent.
#[derive(Clone)]
pub struct Inverse {
    idm: Arc<TrainedIdm>,
    settings: InverseSettings,
    /// Of each step, the last ones for all that follow: (h, w, C) each.
    goals: Vec<Tensor>,
}

impl std::fmt::Debug for Inverse {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Inverse")
            .field("settings", &self.settings)
            .field("goals", &self.goals.len())
            .finish_non_exhaustive()
    }
}

impl Inverse {
    /// Plans to `goals`, latents (h, w, C) in the order in which they are to be reached; each is the goal of one step, and
    /// the last one of all that follow.
    ///
    /// # Errors
    /// [`PlanError::Setting`] where the model tells several steps at once, or there is no goal.
    pub fn new(
        idm: Arc<TrainedIdm>,
        settings: InverseSettings,
        goals: Vec<Tensor>,
    ) -> Result<Self, PlanError> {
        let steps = idm.idm().horizon();
        if steps != 1 {
            return Err(PlanError::Setting(format!(
                "an inverse dynamics model of one step is needed, not of {steps}"
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

    /// The actions that the model tells, (k, searched values) within the limits.
    pub(crate) fn tell(&self, problem: &mut Problem<'_>) -> Result<Vec<Vec<f32>>, PlanError> {
        let observed = problem.dynamics.start()?;
        let mut from = observed.clone();
        let mut told: Vec<f32> = Vec::new();
        for step in 0..problem.horizon {
            let goal = self.goals.get(step).or(self.goals.last());
            let Some(goal) = goal else { break };
            let (before, to) = match self.settings.path {
                Path::Imagined => (from.clone(), goal.clone()),
                Path::Line => {
                    // A plan has few steps.
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
            told.extend(problem.space.searched(&action));
            told = problem.space.limit(told);
            let is_last = step + 1 == problem.horizon;
            if self.settings.path == Path::Imagined && !is_last {
                let latents = problem.rollout(std::slice::from_ref(&told))?;
                from = latents.get(0)?.get(step)?;
            }
        }
        let values = problem.space.len();
        Ok(told.chunks_exact(values).map(<[f32]>::to_vec).collect())
    }
}

impl Planner for Inverse {
    fn name(&self) -> &'static str {
        "idm"
    }

    fn plan(
        &self,
        problem: &mut Problem<'_>,
        _: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError> {
        let told = self.tell(problem)?;
        let mut search = Search::new(problem, watch)?;
        search.iterate(vec![told.concat()])?;
        search.finish(None)
    }
}
