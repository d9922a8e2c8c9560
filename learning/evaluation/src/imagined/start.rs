//! All policies from one start, on the arm and in imagination.

use anyhow::{Context as _, Result, bail};
use candle_core::Tensor;
use image::RgbImage;
use wm_planner::{Dynamics as _, TransitionDynamics};
use wm_sim::{EndEffectorAction, Environment, GoalKind, Performance, ScriptedPolicy, Variety};
use wm_zoo::success_probe::SuccessClassifier;

use super::candidate::Candidate;
use crate::{
    CONTEXT,
    closed_loop::{actor::rest, model::Model, trial::LEAST_STEPS},
    picture_strip::png,
    policy::{
        Actor, Imagination, Policy, Start as ImaginedStart, Trial, imagine,
        protocol::{ActionSpaceInfo, Request, VERSION},
    },
};

/// Settings of all starts.
pub struct Setup<'a> {
    pub task: GoalKind,
    pub candidates: &'a [Candidate],
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

/// What the world model and the policies know at the start.
struct Observed {
    /// (`CONTEXT`, h, w, C).
    latents: Tensor,
    /// (1, A): the model action between them.
    between: Tensor,
    /// The newest picture, in the model's size.
    picture: RgbImage,
    /// The last command before it.
    last: [f32; 7],
    instruction: String,
    seed: u64,
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
        let done = rest(&mut environment, model.frames_per_step())?;
        let picture = environment.picture();
        let observed = Observed {
            latents: Tensor::stack(&[first, model.encode(&picture)?], 0)?,
            between: model.action(&done)?,
            picture: model.resized(&picture)?,
            last: done.last().context("no command before the start")?.values(),
            instruction: environment.instruction().to_owned(),
            seed,
        };
        let executed = self.candidates.iter();
        let executed = executed.map(|candidate| match candidate {
            Candidate::Scripted(policy) => self.execute(*policy, environment.clone(), steps),
            Candidate::Program { name, policy } => self
                .execute_program(policy, environment.clone(), &observed, steps)
                .with_context(|| format!("{name} on the arm, seed {seed}")),
        });
        let executed = executed.collect::<Result<Vec<_>>>()?;
        let imagined = self.imagine(&observed, &executed, steps)?;
        let outcome = |(index, executed): (usize, &Execution)| -> Result<Outcome> {
            let probability = |after: &Tensor| {
                let episode = Tensor::cat(&[&observed.latents, after], 0)?;
                Ok::<f32, anyhow::Error>(probe.probability(&episode, &instruction)?)
            };
            Ok(Outcome {
                executed: executed.environment.solved(),
                followed: executed.environment.instruction_followed(),
                distance_m: executed.environment.distance_m(),
                seen: probability(&executed.latents)?,
                imagined: probability(imagined.get(index).context("no imagined episode")?)?,
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
        environment: Environment,
        steps: usize,
    ) -> Result<Execution> {
        let mut performance = Performance::new(policy, &environment);
        self.record(environment, steps, |environment, _| {
            let mut commands = Vec::new();
            for _ in 0..self.model.frames_per_step() {
                let command = performance.command(environment.world());
                environment.step(&command)?;
                commands.push(command);
            }
            Ok(commands)
        })
    }

    /// The program sees the arm's pictures.
    fn execute_program(
        &self,
        policy: &Policy,
        environment: Environment,
        observed: &Observed,
        steps: usize,
    ) -> Result<Execution> {
        let encoding = &self.model.world.encoding;
        let space = ActionSpaceInfo::of(encoding);
        let task = format!("{} {} on the arm", self.task, observed.seed);
        let mut actor = Actor::new(policy, encoding, &observed.last, &[]);
        self.record(environment, steps, |environment, step| {
            if actor.needs_actions() {
                actor.request(&Request {
                    version: VERSION,
                    task: &task,
                    trial: 0,
                    seed: observed.seed,
                    step,
                    instruction: &observed.instruction,
                    image: png(&self.model.resized(&environment.picture())?)?,
                    views: 1,
                    state: None,
                    action_space: &space,
                })?;
            }
            let mut commands = Vec::new();
            for values in actor.step().0 {
                let Ok(values) = <[f32; 7]>::try_from(values) else {
                    bail!("expected actions of seven values");
                };
                let command = EndEffectorAction::from_values(values);
                environment.step(&command)?;
                commands.push(command);
            }
            Ok(commands)
        })
    }

    /// Acts for some model steps. `act` executes the commands of one.
    fn record(
        &self,
        mut environment: Environment,
        steps: usize,
        mut act: impl FnMut(&mut Environment, usize) -> Result<Vec<EndEffectorAction>>,
    ) -> Result<Execution> {
        let (mut actions, mut latents) = (Vec::new(), Vec::new());
        for step in 0..steps {
            let commands = act(&mut environment, step)?;
            actions.push(self.model.action(&commands)?);
            latents.push(self.model.encode(&environment.picture())?);
        }
        Ok(Execution {
            actions: Tensor::cat(&actions, 0)?,
            latents: Tensor::stack(&latents, 0)?,
            environment,
        })
    }

    /// Predictions (steps, h, w, C) by candidate, all with the noise of the start's seed.
    fn imagine(
        &self,
        observed: &Observed,
        executed: &[Execution],
        steps: usize,
    ) -> Result<Vec<Tensor>> {
        let pairs = self.candidates.iter().zip(executed);
        let scripted = pairs.filter(|(candidate, _)| matches!(candidate, Candidate::Scripted(_)));
        let actions: Vec<&Tensor> = scripted.map(|(_, executed)| &executed.actions).collect();
        // In one batch.
        let scripted = match actions.as_slice() {
            [] => Vec::new(),
            actions => {
                let transition = &self.model.world.transition;
                let mut dynamics = TransitionDynamics::new(
                    transition,
                    &transition.config().sampler,
                    &observed.latents.unsqueeze(0)?,
                    Some(&observed.between),
                    observed.seed,
                )?;
                let predicted = dynamics.rollout(&Tensor::stack(actions, 0)?)?;
                (0..actions.len())
                    .map(|index| predicted.get(index))
                    .collect::<candle_core::Result<Vec<_>>>()?
            }
        };
        let mut scripted = scripted.into_iter();
        let each = self.candidates.iter().map(|candidate| match candidate {
            Candidate::Scripted(_) => scripted.next().context("no prediction of a policy"),
            Candidate::Program { name, policy } => self
                .imagine_program(policy, observed, steps)
                .with_context(|| format!("{name} in imagination")),
        });
        each.collect()
    }

    /// The program sees the predicted pictures.
    fn imagine_program(
        &self,
        policy: &Policy,
        observed: &Observed,
        steps: usize,
    ) -> Result<Tensor> {
        let world = &self.model.world;
        let imagination = Imagination {
            world,
            sampler: &world.transition.config().sampler,
            decoder: self.model.decoder.as_deref(),
            views: 1,
        };
        let start = ImaginedStart {
            latents: observed.latents.unsqueeze(0)?,
            past: observed.between.clone(),
            picture: observed.picture.clone(),
            last: observed.last.to_vec(),
            recorded: Vec::new(),
        };
        let task = format!("{} {} in imagination", self.task, observed.seed);
        let trial = Trial {
            task: &task,
            trial: 0,
            seed: observed.seed,
            instruction: &observed.instruction,
        };
        let episode = imagine(imagination, policy, &start, trial, (steps, false))?;
        Ok(episode.latents.narrow(0, CONTEXT, steps)?)
    }
}
