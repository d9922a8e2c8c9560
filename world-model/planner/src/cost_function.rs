//! The cost of candidates, in a form that can be sent to other processes.

use serde::{Deserialize, Serialize};
use wm_model::{
    sampler::{Noise, Position, Rollout, Sampler},
    transition::LoadedTransition,
};

use crate::{
    Array, Costs, Objective, PlanError, PortableTerm, Problem, SearchSpace, TransitionDynamics,
};

/// Most steps of a plan.
const MOST_STEPS: usize = 64;
/// Most terms of an objective.
const MOST_TERMS: usize = 64;

/// The serialisable function from candidates to costs for one plan. With the same transition model and kernels
/// ([`crate::fingerprint`]), another process computes the same costs, bit for bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CostFunction {
    /// (1, T, h, w, C), see [`Position`].
    context: Array,
    /// (T - 1, A).
    actions: Option<Array>,
    seed: u64,
    first_step: u64,
    sampler: Sampler,
    /// (1, A), see [`TransitionDynamics::ending_with`].
    last: Option<Array>,
    space: SearchSpace,
    /// Steps of a candidate.
    horizon: usize,
    terms: Vec<(f32, PortableTerm)>,
}

impl CostFunction {
    /// The cost function of a problem with `horizon` steps.
    ///
    /// # Errors
    /// [`PlanError::NotPortable`] names a term that needs more than the transition model.
    pub fn of(
        dynamics: &TransitionDynamics<'_>,
        objective: &Objective,
        space: &SearchSpace,
        horizon: usize,
    ) -> Result<Self, PlanError> {
        let Position {
            context,
            actions,
            noise,
        } = dynamics.rollout_from().position()?;
        Ok(Self {
            terms: objective.portable()?,
            context: Array::of(&context)?,
            actions: actions.as_ref().map(Array::of).transpose()?,
            seed: noise.seed,
            first_step: noise.first_step as u64,
            sampler: dynamics.rollout_from().sampler().clone(),
            last: dynamics.last_action().map(Array::of).transpose()?,
            space: space.clone(),
            horizon,
        })
    }

    /// Values of a candidate: steps x searched values.
    pub fn candidate_len(&self) -> usize {
        self.horizon * self.space.len()
    }

    /// Number of terms.
    pub fn terms(&self) -> usize {
        self.terms.len()
    }

    /// Binds the function to a model.
    ///
    /// # Errors
    /// [`PlanError`] names an invalid part, or one that does not fit the model.
    pub fn with<'m>(&self, model: &'m LoadedTransition) -> Result<Evaluator<'m>, PlanError> {
        let complain = |text: String| Err(PlanError::Setting(text));
        if !(1..=MOST_STEPS).contains(&self.horizon) {
            return complain(format!(
                "plans of {} steps, expected 1 to {MOST_STEPS}",
                self.horizon
            ));
        }
        if !(1..=MOST_TERMS).contains(&self.terms.len()) {
            return complain(format!(
                "a cost of {} terms, expected 1 to {MOST_TERMS}",
                self.terms.len()
            ));
        }
        let (own, given) = (model.config().action_dim, self.space.action_dim());
        if own != given {
            return complain(format!(
                "the model's actions have {own} values, but those of the search space {given}"
            ));
        }
        let Ok(first_step) = usize::try_from(self.first_step) else {
            return complain(format!("invalid noise step {}", self.first_step));
        };
        let position = Position {
            context: self.context.tensor()?,
            actions: self.actions.as_ref().map(Array::tensor).transpose()?,
            noise: Noise {
                seed: self.seed,
                first_step,
            },
        };
        let rollout = Rollout::resume(model, &self.sampler, &position)?;
        let dynamics = TransitionDynamics::after(rollout)?;
        let dynamics = match &self.last {
            Some(last) => dynamics.ending_with(&last.tensor()?)?,
            None => dynamics,
        };
        Ok(Evaluator {
            dynamics,
            objective: Objective::of_portable(&self.terms)?,
            space: self.space.clone(),
            horizon: self.horizon,
        })
    }
}

/// A cost function with its model.
#[derive(Debug)]
pub struct Evaluator<'m> {
    dynamics: TransitionDynamics<'m>,
    objective: Objective,
    space: SearchSpace,
    horizon: usize,
}

impl Evaluator<'_> {
    /// Costs of at least one candidate, each of steps x searched values within the limits.
    ///
    /// # Errors
    /// [`PlanError::Setting`] for a candidate with the wrong number of values or a value that is not finite, and those
    /// of the model.
    pub fn costs(&mut self, candidates: &[Vec<f32>]) -> Result<Costs, PlanError> {
        let expected = self.horizon * self.space.len();
        for candidate in candidates {
            if candidate.len() != expected || candidate.iter().any(|value| !value.is_finite()) {
                return Err(PlanError::Setting(format!(
                    "expected {expected} finite values for a candidate, got {candidate:?}"
                )));
            }
        }
        let mut problem = Problem {
            space: &self.space,
            dynamics: &mut self.dynamics,
            objective: &self.objective,
            horizon: self.horizon,
            batch: candidates.len(),
            proposals: Vec::new(),
            workers: None,
        };
        problem.costs(candidates)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};
    use wm_model::transition::{ActionAlignment, Transition, TransitionConfig};

    use super::*;
    use crate::{
        ActionSize, Coordinate, GoalDistance, Range, Smoothness, Target, Workspace, WorkspaceAxis,
        WorkspaceMargin,
    };

    fn model(action_alignment: ActionAlignment) -> LoadedTransition {
        let config = TransitionConfig {
            hidden: 64,
            depth: 2,
            heads: 2,
            action_alignment,
            ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 10).unwrap()
        };
        Transition::random(config, 3).unwrap().pack().unwrap()
    }

    fn waves(shape: &[usize], pitch: f32) -> Tensor {
        let count = shape.iter().product::<usize>();
        let values: Vec<f32> = (0..count).map(|i| (i as f32 * pitch).sin()).collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    fn space() -> SearchSpace {
        let between = |index| Coordinate {
            index,
            range: Range::Between(-1.0, 1.0),
            rate: 0.5,
        };
        let gripper = Coordinate {
            index: 6,
            range: Range::Either(-1.0, 1.0),
            rate: f32::INFINITY,
        };
        let axes = vec![WorkspaceAxis {
            coordinate: 1,
            metres: 0.05,
            position: 0.1,
            range: (0.0, 0.3),
        }];
        let coordinates = vec![between(0), between(2), gripper];
        let space = SearchSpace::new(vec![0.25; 10], coordinates).unwrap();
        let space = space.after(&[0.1; 10]).unwrap();
        space.within(Workspace { axes }).unwrap()
    }

    fn objective() -> Objective {
        let goal = waves(&[4, 4, 4], 0.2);
        let mask = waves(&[4, 4], 0.1).abs().unwrap();
        let near = GoalDistance::new(Target::LastStep(goal.clone()));
        let stations = Target::At(vec![(0, goal.clone()), (7, waves(&[4, 4, 4], 0.4))]);
        Objective::of(Target::AllSteps(goal))
            .and(0.7, near.within(&mask).unwrap())
            .and(0.2, GoalDistance::new(stations))
            .and(0.1, ActionSize)
            .and(0.3, Smoothness)
            .and(2.0, WorkspaceMargin { margin: 0.02 })
    }

    fn bits(costs: &Costs) -> Vec<u32> {
        let terms = costs.terms.iter().flatten();
        terms
            .chain(&costs.total)
            .map(|cost| cost.to_bits())
            .collect()
    }

    #[test]
    fn deserialised_function_gives_equal_costs_to_the_bit() {
        for alignment in [ActionAlignment::WithFrame, ActionAlignment::WithResult] {
            let model = model(alignment);
            let (context, past) = (waves(&[1, 2, 4, 4, 4], 0.3), waves(&[1, 10], 0.9));
            let sampler = Sampler {
                steps: 3,
                ..Sampler::default()
            };
            let mut rollout = Rollout::new(&model, &sampler, &context, Some(&past), 5).unwrap();
            // Some steps are predicted before the plan starts.
            for step in 0..3 {
                rollout.next(&waves(&[1, 10], step as f32)).unwrap();
            }
            let dynamics = TransitionDynamics::after(rollout).unwrap();
            let ending = dynamics.clone().ending_with(&waves(&[1, 10], 0.6)).unwrap();
            let (space, objective) = (space(), objective());
            for mut dynamics in [dynamics, ending] {
                let function = CostFunction::of(&dynamics, &objective, &space, 2).unwrap();
                let candidates: Vec<Vec<f32>> = (0..5)
                    .map(|i| (0..6).map(|j| ((i * 6 + j) as f32).sin()).collect())
                    .map(|candidate| space.limit(candidate))
                    .collect();
                let mut problem = Problem {
                    space: &space,
                    dynamics: &mut dynamics,
                    objective: &objective,
                    horizon: 2,
                    batch: 5,
                    proposals: Vec::new(),
                    workers: None,
                };
                let own = problem.costs(&candidates).unwrap();
                let mut evaluator = function.with(&model).unwrap();
                let again = evaluator.costs(&candidates).unwrap();
                assert_eq!(bits(&again), bits(&own));
                // The cost does not depend on the other candidates of the batch.
                let part = evaluator.costs(&candidates[3..]).unwrap();
                assert_eq!(part.terms, own.terms[3..]);
                assert_eq!((function.candidate_len(), function.terms()), (6, 6));
            }
        }
    }

    #[test]
    fn mismatch_with_the_model_is_named() {
        let model = model(ActionAlignment::WithFrame);
        let context = waves(&[1, 1, 4, 4, 4], 0.3);
        let sampler = &model.config().sampler;
        let dynamics = TransitionDynamics::new(&model, sampler, &context, None, 5).unwrap();
        let sound = CostFunction::of(&dynamics, &objective(), &space(), 2).unwrap();
        let refused = |function: CostFunction| function.with(&model).unwrap_err().to_string();
        let endless = refused(CostFunction {
            horizon: 1000,
            ..sound.clone()
        });
        assert!(endless.contains("1000 steps"), "{endless}");
        let pointless = refused(CostFunction {
            terms: Vec::new(),
            ..sound.clone()
        });
        assert!(pointless.contains("0 terms"), "{pointless}");
        let other = Tensor::zeros((1, 1, 4, 4, 8), DType::F32, &Device::Cpu).unwrap();
        let strange = refused(CostFunction {
            context: Array::of(&other).unwrap(),
            ..sound.clone()
        });
        assert!(strange.contains("[1, 1, 4, 4, 8]"), "{strange}");
        let narrow = refused(CostFunction {
            space: SearchSpace::bounded(&[(-1.0, 1.0)], 7).unwrap(),
            ..sound.clone()
        });
        assert!(narrow.contains("10") && narrow.contains('7'), "{narrow}");
        let weightless = refused(CostFunction {
            terms: vec![(f32::NAN, PortableTerm::ActionSize)],
            ..sound.clone()
        });
        assert!(weightless.contains("NaN"), "{weightless}");
        let mut evaluator = sound.with(&model).unwrap();
        for candidate in [vec![0.0; 5], vec![f32::NAN; 6]] {
            let complaint = evaluator.costs(&[candidate]).unwrap_err().to_string();
            assert!(
                complaint.contains("expected 6 finite values"),
                "{complaint}"
            );
        }
    }
}
