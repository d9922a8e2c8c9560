//! From candidates to an assessment.

use std::sync::Arc;

use wm_msgs::wm_msgs::{Assessment, CandidateAssessment, Timing as TimingMessage};
use wm_planner::Target;
use wm_zoo::success_probe::{Instruction, SuccessClassifier};

use super::{EvaluationRequest, EvaluatorError};
use wm_model::WorldModel;

use crate::history::model_values;
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
    /// Predicted latents of each step, one for each candidate; normalised, row-major, channels last.
    pub latents: Vec<Vec<Vec<f32>>>,
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
        // One of each candidate.
        let actions = |step: usize| -> Vec<&[f32]> {
            let candidates = request.candidates.iter();
            let of_step = candidates.filter_map(|steps| steps.get(step));
            of_step.map(model_values).collect()
        };
        let mut sampler = transition.config().sampler.clone();
        sampler.steps = self.integration_steps;
        let mut rollout = moment.rollout(transition, &sampler, request.seed)?;
        rollout.prepare()?;
        let mut rollout = rollout.candidates(count)?;
        let mut latents = Vec::with_capacity(horizon);
        for step in 0..horizon {
            latents.push(rollout.predict(&actions(step), Some(&actions(step + 1)))?);
        }
        let probabilities = self.probabilities(
            &moment.context(),
            &latents,
            count,
            request.instruction.as_deref(),
        )?;

        let mut step_costs = vec![Vec::new(); count];
        if let Some(goal) = request.goal.as_ref().and_then(|goal| goal.latents.last()) {
            let target = Target::last_step(space, goal)?;
            for of_step in &latents {
                let of_step: Vec<&[f32]> = of_step.iter().map(Vec::as_slice).collect();
                let costs = target.step_costs(space, &of_step)?;
                for (all, cost) in step_costs.iter_mut().zip(costs) {
                    all.push(cost);
                }
            }
        }
        let mut candidates = Vec::with_capacity(count);
        let last = latents.last().into_iter().flatten();
        let found = (0_u32..).zip(last).zip(step_costs).zip(probabilities);
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
            // At most 64, by the parameter.
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

    /// Probability of each of `count` candidates that its imagined episode carries out the instruction; NaN without a
    /// probe or an instruction. The probe was trained on whole episodes; known of this one are the newest observed frames,
    /// `context`, and then the predicted `latents`. One by one, so that an episode's probability depends on no other.
    fn probabilities(
        &self,
        context: &[&[f32]],
        latents: &[Vec<Vec<f32>>],
        count: usize,
        instruction: Option<&Instruction>,
    ) -> Result<Vec<f32>, EvaluatorError> {
        let (Some(probe), Some(instruction)) = (&self.probe, instruction) else {
            return Ok(vec![f32::NAN; count]);
        };
        let of_one = |index| {
            let mut frames = context.to_vec();
            let predicted = latents
                .iter()
                .filter_map(|of_step: &Vec<Vec<f32>>| of_step.get(index));
            frames.extend(predicted.map(Vec::as_slice));
            let episode = self.model.space.stack(&frames)?;
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
