//! All policies from one start, on the arm and in imagination.

use anyhow::{Context as _, Result};
use candle_core::Tensor;
use wm_planner::{Dynamics as _, TransitionDynamics};
use wm_sim::{Environment, GoalKind, Variety};
use wm_zoo::success_probe::SuccessClassifier;

use super::{performance::Performance, scripted::ScriptedPolicy};
use crate::{
    CONTEXT,
    closed_loop::{actor::rest, model::Model, trial::LEAST_STEPS},
};

/// Settings of all starts.
pub struct Setup<'a> {
    pub task: GoalKind,
    pub policies: &'a [ScriptedPolicy],
    pub model: &'a Model,
    pub probe: &'a SuccessClassifier,
    /// Length of an episode, as a multiple of the oracle's.
    pub patience: f64,
}

/// Results of the policies from one start.
#[derive(Clone, Debug)]
pub struct Start {
    pub seed: u64,
    /// Model steps after the observed frames, equal for all policies.
    pub steps: usize,
    /// By policy.
    pub outcomes: Vec<Outcome>,
}

/// Result of a policy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Whether the goal was reached in the end.
    pub executed: bool,
    /// Whether the final state follows the instruction.
    pub followed: bool,
    /// Remaining distance to the goal \[m\].
    pub distance_m: f64,
    /// Probability of success by the true pictures.
    pub seen: f32,
    /// Probability of success in imagination.
    pub imagined: f32,
}

/// Commands of a policy, and the resulting pictures.
struct Execution {
    /// (steps, A): the commands.
    actions: Tensor,
    /// (steps, h, w, C): after each step.
    latents: Tensor,
    environment: Environment,
}

impl Setup<'_> {
    /// Runs all policies from the start of a seed.
    ///
    /// # Errors
    /// If the start does not exist, the probe does not know its instruction, or the model fails.
    pub fn run(&self, seed: u64) -> Result<Start> {
        let Self { model, probe, .. } = self;
        let mut environment = Environment::new(self.task, seed, &Variety::default())?;
        let instruction = probe.instruction(environment.instruction())?;
        let steps = self.steps(&environment)?;
        // The model starts from two frames.
        let first = model.encode(&environment.picture())?;
        let between = model.action(&rest(&mut environment, model.frames_per_step())?)?;
        let observed = Tensor::stack(&[first, model.encode(&environment.picture())?], 0)?;
        let executed = self.policies.iter();
        let executed = executed.map(|policy| self.execute(*policy, environment.clone(), steps));
        let executed = executed.collect::<Result<Vec<_>>>()?;
        let imagined = self.imagine(&observed, &between, &executed, seed)?;
        let outcome = |(index, executed): (usize, &Execution)| -> Result<Outcome> {
            let probability = |after: &Tensor| {
                let episode = Tensor::cat(&[&observed, after], 0)?;
                Ok::<f32, anyhow::Error>(probe.probability(&episode, &instruction)?)
            };
            Ok(Outcome {
                executed: executed.environment.solved(),
                followed: executed.environment.instruction_followed(),
                distance_m: executed.environment.distance_m(),
                seen: probability(&executed.latents)?,
                imagined: probability(&imagined.get(index)?)?,
            })
        };
        let outcomes = executed.iter().enumerate().map(outcome);
        Ok(Start {
            seed,
            steps,
            outcomes: outcomes.collect::<Result<_>>()?,
        })
    }

    /// Model steps of an episode: equal for all policies, so that its length is no clue, and at most those that the
    /// probe reads.
    fn steps(&self, environment: &Environment) -> Result<usize> {
        let most = self.probe.max_frames().checked_sub(CONTEXT);
        let most = most.filter(|most| *most > 0);
        let most = most.context("the success probe reads no frame beside the observed ones")?;
        // An episode has a few dozen actions.
        let of_oracle = environment.solution().len() as f64 / self.model.frames_per_step() as f64;
        let steps = (of_oracle * self.patience).ceil().max(LEAST_STEPS);
        Ok((steps as usize).min(most))
    }

    fn execute(
        &self,
        policy: ScriptedPolicy,
        mut environment: Environment,
        steps: usize,
    ) -> Result<Execution> {
        let seed = environment.seed();
        let mut performance = Performance::new(policy, &environment, seed);
        let (mut actions, mut latents) = (Vec::new(), Vec::new());
        for _ in 0..steps {
            let mut commands = Vec::new();
            for _ in 0..self.model.frames_per_step() {
                let command = performance.command(&environment);
                environment.step(&command)?;
                commands.push(command);
            }
            actions.push(self.model.action(&commands)?);
            latents.push(self.model.encode(&environment.picture())?);
        }
        Ok(Execution {
            actions: Tensor::cat(&actions, 0)?,
            latents: Tensor::stack(&latents, 0)?,
            environment,
        })
    }

    /// Predictions for the policies' commands, in one batch with one noise: (policies, steps, h, w, C).
    fn imagine(
        &self,
        observed: &Tensor,
        between: &Tensor,
        executed: &[Execution],
        seed: u64,
    ) -> Result<Tensor> {
        let transition = &self.model.world.transition;
        let mut dynamics = TransitionDynamics::new(
            transition,
            &transition.config().sampler,
            &observed.unsqueeze(0)?,
            Some(between),
            seed,
        )?;
        let actions: Vec<&Tensor> = executed.iter().map(|executed| &executed.actions).collect();
        Ok(dynamics.rollout(&Tensor::stack(&actions, 0)?)?)
    }
}
