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

/// What is tried.
pub struct Setup<'a> {
    pub task: GoalKind,
    pub policies: &'a [ScriptedPolicy],
    pub model: &'a Model,
    pub probe: &'a SuccessClassifier,
    /// Length of an episode, as a multiple of the oracle's.
    pub patience: f64,
}

/// What came of the policies from one start.
#[derive(Clone, Debug)]
pub struct Start {
    pub seed: u64,
    /// Model steps after the observed frames, the same for all policies.
    pub steps: usize,
    /// In the order of the policies.
    pub outcomes: Vec<Outcome>,
}

/// What came of a policy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Whether the goal was attained in the end.
    pub executed: bool,
    /// Whether in the end things stood as the instruction asks.
    pub followed: bool,
    /// What was missing in the end \[m\].
    pub distance_m: f64,
    /// Probability of success by the pictures that came.
    pub seen: f32,
    /// Probability of success in imagination.
    pub imagined: f32,
}

/// What a policy did, and what the camera saw of it.
struct Executed {
    /// (steps, A): the commands.
    actions: Tensor,
    /// (steps, h, w, C): after each step.
    latents: Tensor,
    environment: Environment,
}

impl Setup<'_> {
    /// Lets all policies act from the start of a seed.
    ///
    /// # Errors
    /// If there is no such start, the probe does not read its instruction, or the model fails.
    pub fn run(&self, seed: u64) -> Result<Start> {
        let Self { model, probe, .. } = self;
        let mut environment = Environment::new(self.task, seed, &Variety::default())?;
        let instruction = probe.instruction(environment.instruction())?;
        let steps = self.steps(&environment)?;
        // Two frames are what the model starts from.
        let first = model.encode(&environment.picture())?;
        let between = model.action(&rest(&mut environment, model.frames_per_step())?)?;
        let observed = Tensor::stack(&[first, model.encode(&environment.picture())?], 0)?;
        let executed = self.policies.iter();
        let executed = executed.map(|policy| self.execute(*policy, environment.clone(), steps));
        let executed = executed.collect::<Result<Vec<_>>>()?;
        let imagined = self.imagine(&observed, &between, &executed, seed)?;
        let outcome = |(index, executed): (usize, &Executed)| -> Result<Outcome> {
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

    /// Model steps of an episode: for all policies the same, so that its length tells nothing, and no more than the probe
    /// reads.
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
    ) -> Result<Executed> {
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
        Ok(Executed {
            actions: Tensor::cat(&actions, 0)?,
            latents: Tensor::stack(&latents, 0)?,
            environment,
        })
    }

    /// What the world model makes of the policies' commands, side by side and under one noise: (policies, steps, h, w, C).
    fn imagine(
        &self,
        observed: &Tensor,
        between: &Tensor,
        executed: &[Executed],
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
