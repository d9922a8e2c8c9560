//! The transition model as the dynamics of a plan.

use candle_core::Tensor;

use wm_model::{
    Error, Result,
    sampler::{Given, Noise, Rollout, Sampler},
    transition::LoadedTransition,
};

use crate::Dynamics;

/// Rolls out candidates with the transition model, from one context (keys and values are computed once) and one noise
/// per step, shared by all candidates of all iterations.
#[derive(Clone, Debug)]
pub struct TransitionDynamics<'m> {
    start: Rollout<'m>,
    action_dim: usize,
    /// Own action (1, A) of the last predicted frame, if known.
    last: Option<Tensor>,
}

impl<'m> TransitionDynamics<'m> {
    /// Dynamics from the observed `context` (1, T, h, w, C), oldest first, with the `actions` (T - 1, A) between its
    /// frames (`None` for T = 1), and the noise of `noise_seed`.
    ///
    /// # Errors
    /// If shapes do not fit the model, or a value is not finite.
    pub fn new(
        model: &'m LoadedTransition,
        sampler: &Sampler,
        context: &Tensor,
        actions: Option<&Tensor>,
        noise_seed: u64,
    ) -> Result<Self> {
        Self::after(Rollout::new(model, sampler, context, actions, noise_seed)?)
    }

    /// Dynamics that continue a rollout.
    ///
    /// # Errors
    /// If the model fails.
    pub fn after(mut start: Rollout<'m>) -> Result<Self> {
        start.prepare()?;
        let action_dim = start.action_dim();
        Ok(Self {
            start,
            action_dim,
            last: None,
        })
    }

    /// Sets the own `action` (1, A) of the last predicted frame. By default it repeats the last searched one.
    ///
    /// # Errors
    /// If the shape does not fit.
    pub fn ending_with(self, action: &Tensor) -> Result<Self> {
        if action.dims() != [1, self.action_dim] {
            return Err(Error::Shape {
                what: "the action after the last step",
                expected: format!("(1, {})", self.action_dim),
                found: action.dims().to_vec(),
            });
        }
        Ok(Self {
            last: Some(action.clone()),
            ..self
        })
    }

    /// The rollout that all candidates continue.
    pub(crate) fn rollout_from(&self) -> &Rollout<'m> {
        &self.start
    }

    /// The action (1, A) of [`Self::ending_with`].
    pub(crate) fn last_action(&self) -> Option<&Tensor> {
        self.last.as_ref()
    }
}

impl TransitionDynamics<'_> {
    /// Latents (N, k, h, w, C) of one sequence of `actions` (1, k, A) under the noise of N `seeds`.
    ///
    /// # Errors
    /// If the shape does not fit, `seeds` is empty, or the model fails.
    pub fn rollout_under(&self, actions: &Tensor, seeds: &[u64]) -> Result<Tensor> {
        let noise: Vec<Noise> = seeds
            .iter()
            .map(|seed| Noise {
                seed: *seed,
                first_step: 0,
            })
            .collect();
        let (_, steps, values) = actions.dims3()?;
        let actions = actions.broadcast_as((seeds.len(), steps, values))?;
        self.follow(self.start.candidates_under(&noise)?, &actions)
    }

    /// Latents of N candidates with `actions` (N, k, A).
    fn follow(&self, mut rollout: Rollout<'_>, actions: &Tensor) -> Result<Tensor> {
        let steps = actions.dim(1)?;
        let mut latents = Vec::with_capacity(steps);
        let at = |step: usize| actions.narrow(1, step, 1)?.squeeze(1)?.contiguous();
        for step in 0..steps {
            let own = match &self.last {
                Some(last) if step + 1 == steps => last.clone(),
                // By default the last action is repeated.
                _ => at((step + 1).min(steps - 1))?,
            };
            let given = Given {
                own_action: Some(&own),
                ..Given::default()
            };
            latents.push(rollout.next_given(&at(step)?, given)?);
        }
        Ok(Tensor::stack(&latents, 1)?)
    }
}

impl Dynamics for TransitionDynamics<'_> {
    fn action_dim(&self) -> usize {
        self.action_dim
    }

    fn start(&self) -> Result<Tensor> {
        self.start.newest()
    }

    fn rollout(&mut self, actions: &Tensor) -> Result<Tensor> {
        self.follow(self.start.candidates(actions.dim(0)?)?, actions)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;
    use crate::{Cem, CemSettings, Objective, Planner as _, Problem, SearchSpace, Target, spread};
    use wm_model::transition::{ActionAlignment, Transition, TransitionConfig};
    use wm_model::{Compute, Kernels, NumberFormat};

    fn model() -> LoadedTransition {
        let config = TransitionConfig {
            hidden: 64,
            depth: 2,
            heads: 2,
            ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 10).unwrap()
        };
        Transition::random(config, 3).unwrap().pack().unwrap()
    }

    fn context() -> Tensor {
        let values: Vec<f32> = (0..2 * 64).map(|i| (i as f32 * 0.37).sin()).collect();
        Tensor::from_vec(values, (1, 2, 4, 4, 4), &Device::Cpu).unwrap()
    }

    #[test]
    fn last_frame_carries_the_known_action() {
        // Every frame carries the action that follows it, as in the paper.
        let config = TransitionConfig {
            action_alignment: ActionAlignment::WithFrame,
            ..model().config().clone()
        };
        let model = Transition::random(config, 3).unwrap().pack().unwrap();
        let context = context();
        let past = Tensor::zeros((1, 10), DType::F32, &Device::Cpu).unwrap();
        let sampler = &model.config().sampler;
        let new = || TransitionDynamics::new(&model, sampler, &context, Some(&past), 5).unwrap();
        let values: Vec<f32> = (0..20).map(|i| (i as f32 * 0.7).sin()).collect();
        let actions = Tensor::from_vec(values, (1, 2, 10), &Device::Cpu).unwrap();
        let latents = |mut dynamics: TransitionDynamics<'_>| {
            let rolled = dynamics.rollout(&actions).unwrap();
            rolled
                .squeeze(0)
                .unwrap()
                .flatten_from(1)
                .unwrap()
                .to_vec2::<f32>()
                .unwrap()
        };
        let searched = actions.narrow(1, 1, 1).unwrap().squeeze(1).unwrap();
        let known = (&searched * -1.0).unwrap();
        let going_on = latents(new());
        assert_eq!(latents(new().ending_with(&searched).unwrap()), going_on);
        let ending = latents(new().ending_with(&known).unwrap());
        assert_eq!(ending[0], going_on[0], "only the last frame carries it");
        assert_ne!(ending[1], going_on[1]);
        let short = known.narrow(1, 0, 9).unwrap();
        assert!(new().ending_with(&short).is_err());
    }

    /// Enough candidates for both paths, over a window that fills up.
    #[test]
    fn tensor_operations_and_kernels_agree() {
        let config = TransitionConfig {
            max_frames: 4,
            ..model().config().clone()
        };
        let transition = Transition::random(config, 3).unwrap();
        let recording = Compute::on_cpu(Kernels::Candle).recording(true);
        let on_tensors = recording.load(transition.clone(), NumberFormat::F32);
        let models = [transition.pack().unwrap(), on_tensors.unwrap()];
        let past = Tensor::zeros((1, 10), DType::F32, &Device::Cpu).unwrap();
        for candidates in [3, 2049] {
            let values: Vec<f32> = (0..candidates * 30)
                .map(|i| (i as f32 * 0.7).sin())
                .collect();
            let actions = Tensor::from_vec(values, (candidates, 3, 10), &Device::Cpu).unwrap();
            let [kernels, tensors] = [0, 1].map(|index| {
                let model: &LoadedTransition = &models[index];
                let sampler = Sampler {
                    steps: 2,
                    ..model.config().sampler.clone()
                };
                let context = context();
                let start = TransitionDynamics::new(model, &sampler, &context, Some(&past), 5);
                start.unwrap().rollout(&actions).unwrap()
            });
            assert_eq!(kernels.dims(), [candidates, 3, 4, 4, 4]);
            let difference = (kernels - tensors).unwrap().abs().unwrap();
            let most: f32 = difference.max_all().unwrap().to_scalar().unwrap();
            assert!(most < 1e-4, "{candidates} candidates: {most}");
        }
    }

    #[test]
    fn plan_cost_equals_the_cost_of_its_rollout() {
        let (model, context) = (model(), context());
        let past = Tensor::zeros((1, 10), DType::F32, &Device::Cpu).unwrap();
        let sampler = &model.config().sampler;
        let mut dynamics =
            TransitionDynamics::new(&model, sampler, &context, Some(&past), 5).unwrap();

        // A goal that the model can reach: the latent after some action.
        let mut truth = Rollout::new(&model, sampler, &context, Some(&past), 5).unwrap();
        let mut action = vec![0.0_f32; 10];
        action[..7].copy_from_slice(&[0.9, -0.6, 0.3, 0.2, -0.4, 0.1, 1.0]);
        let goal = truth
            .next(&Tensor::from_vec(action, (1, 10), &Device::Cpu).unwrap())
            .unwrap();
        let target = Target::LastStep(goal.squeeze(0).unwrap());

        let settings = CemSettings {
            population: 48,
            iterations: 6,
            elites: 8,
            ..CemSettings::default()
        };
        let cem = Cem::new(settings).unwrap();
        let space = SearchSpace::bounded(&[(-2.0, 2.0); 7], 10).unwrap();
        let objective = Objective::of(target.clone());
        let mut problem = Problem {
            space: &space,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon: 1,
            batch: 20,
            proposals: Vec::new(),
            workers: None,
        };
        let plan = cem.plan(&mut problem, 1, &mut |_| false).unwrap();
        assert!(
            plan.cost < plan.iteration_costs[0] / 2.0,
            "{:?}",
            plan.iteration_costs
        );

        let mut alone = Rollout::new(&model, sampler, &context, Some(&past), 5).unwrap();
        let mut padded = plan.actions[0].clone();
        padded.resize(10, 0.0);
        let reached = alone
            .next(&Tensor::from_vec(padded, (1, 10), &Device::Cpu).unwrap())
            .unwrap();
        let cost = target.costs(&reached.unsqueeze(1).unwrap()).unwrap()[0];
        assert_eq!(cost, plan.cost, "alone and in a batch");

        let costs = spread(&dynamics, &objective, &space, &plan.actions, &[5, 6]).unwrap();
        assert_eq!(costs[0], plan.cost, "under the plan's own noise");
        assert_ne!(costs[1], plan.cost, "under another");
    }
}
