//! From candidates to an assessment.

use std::sync::Arc;

use candle_core::{Device, Tensor};
use wm_model::sampler::Given;
use wm_motion::motion::StepAction;
use wm_msgs::wm_msgs::{Assessment, CandidateAssessment, Timing as TimingMessage};
use wm_planner::Target;
use wm_zoo::success_probe::{Instruction, SuccessClassifier};

use super::{EvaluationRequest, EvaluatorError};
use wm_model::WorldModel;

use crate::history::stack;
use wm_wire::latent_message::{LatentDtype, encode_latent};

/// The transition model, its settings, and the success probe.
#[derive(Clone, Debug)]
pub struct EvaluatorModel {
    model: WorldModel,
    integration_steps: usize,
    probe: Option<Arc<SuccessClassifier>>,
}

/// The result of an evaluation.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// The message without its `timing`, which the sender fills in.
    pub assessment: Assessment,
    /// Predicted latents (candidates, steps, h, w, C), normalised.
    pub latents: Tensor,
}

impl EvaluatorModel {
    /// Evaluates with `model`, in `integration_steps` Euler steps per frame (0: the model's own number).
    pub fn new(model: WorldModel, integration_steps: usize) -> Self {
        let integration_steps = match integration_steps {
            0 => model.transition.config().sampler.steps,
            steps => steps,
        };
        Self {
            model,
            integration_steps,
            probe: None,
        }
    }

    /// The same, with a success probe of its latents.
    pub fn with_probe(self, probe: Option<Arc<SuccessClassifier>>) -> Self {
        Self { probe, ..self }
    }

    /// Predicts all candidates of a request in one batch.
    ///
    /// # Errors
    /// [`EvaluatorError`] where the request does not fit the model, or a predicted latent is not finite.
    pub fn evaluate(&self, request: &EvaluationRequest) -> Result<Evaluation, EvaluatorError> {
        let WorldModel {
            transition, space, ..
        } = &self.model;
        let moment = &request.moment;
        let (horizon, count) = (request.horizon, request.candidates.len());
        // (candidates, A) of one step.
        let actions = |step: usize| -> Result<Tensor, EvaluatorError> {
            let of_step = request
                .candidates
                .iter()
                .filter_map(|steps| steps.get(step));
            let of_step: Vec<StepAction> = of_step.cloned().collect();
            stack(&of_step)?.ok_or(EvaluatorError::Count { count, max: count })
        };
        let context = moment.context(space)?;
        let mut sampler = transition.config().sampler.clone();
        sampler.steps = self.integration_steps;
        let mut rollout = moment.rollout(transition, space, &sampler, request.seed)?;
        rollout.prepare()?;
        let mut rollout = rollout.candidates(count)?;
        let mut latents = Vec::with_capacity(horizon);
        for step in 0..horizon {
            let next = actions(step + 1)?;
            let given = Given {
                own_action: Some(&next),
                ..Given::default()
            };
            latents.push(rollout.next_given(&actions(step)?, given)?);
        }
        let latents = Tensor::stack(&latents, 1)?;
        let probabilities =
            self.probabilities(&context, &latents, request.instruction.as_deref())?;

        let mut step_costs = vec![Vec::new(); count];
        if let Some(goal) = request.goal.as_ref().and_then(|goal| goal.latents.last()) {
            let target = Target::LastStep(Tensor::from_slice(goal, space.shape(), &Device::Cpu)?);
            for step in 0..horizon {
                let costs = target.costs(&latents.narrow(1, step, 1)?)?;
                for (all, cost) in step_costs.iter_mut().zip(costs) {
                    all.push(cost);
                }
            }
        }
        let last = latents
            .narrow(1, horizon.saturating_sub(1), 1)?
            .flatten_from(1)?
            .to_vec2::<f32>()?;
        let mut candidates = Vec::with_capacity(count);
        let found = (0_u32..).zip(&last).zip(step_costs).zip(probabilities);
        for (((index, values), step_costs), success_probability) in found {
            candidates.push(CandidateAssessment {
                index,
                cost: step_costs.last().copied().unwrap_or(f32::NAN),
                step_costs,
                success_probability,
                latent: encode_latent(
                    values,
                    space,
                    LatentDtype::F16,
                    moment.header_after(horizon),
                )?,
            });
        }
        let assessment = Assessment {
            header: moment.header_after(0),
            policy: request.policy.clone(),
            candidates_stamp: request.candidates_stamp,
            best: best(&candidates),
            candidates,
            horizon: u32::try_from(horizon).unwrap_or(u32::MAX),
            step_period: moment.step_period(),
            model: self.model.name.clone(),
            model_hash: self.model.hash.clone(),
            seed: request.seed,
            timing: TimingMessage::default(),
        };
        Ok(Evaluation {
            assessment,
            latents,
        })
    }

    /// The probability that each candidate's imagined episode does the task; NaN without a probe or an instruction. The probe
    /// was trained on whole episodes. Here it gets the known part of one: the observed `context` (1, H, h, w, C), then the
    /// predicted `latents` (candidates, steps, h, w, C). Candidates are rated one by one, so that they are independent.
    fn probabilities(
        &self,
        context: &Tensor,
        latents: &Tensor,
        instruction: Option<&Instruction>,
    ) -> Result<Vec<f32>, EvaluatorError> {
        let count = latents.dim(0)?;
        let (Some(probe), Some(instruction)) = (&self.probe, instruction) else {
            return Ok(vec![f32::NAN; count]);
        };
        let observed = context.squeeze(0)?;
        let of_one = |index| {
            let episode = Tensor::cat(&[&observed, &latents.get(index)?], 0)?;
            let probability = probe.probability(&episode, instruction);
            Ok(probability.map_err(wm_model::Error::from)?)
        };
        (0..count).map(of_one).collect()
    }
}

/// The candidate of least cost, the first of equals; -1 if every cost is NaN.
fn best(candidates: &[CandidateAssessment]) -> i32 {
    let costs = candidates
        .iter()
        .filter(|candidate| candidate.cost.is_finite());
    let best = costs.min_by(|a, b| a.cost.total_cmp(&b.cost));
    best.and_then(|best| i32::try_from(best.index).ok())
        .unwrap_or(-1)
}
