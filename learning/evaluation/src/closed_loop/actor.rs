//! Acts step by step.

use std::{sync::Arc, time::Instant};

use anyhow::{Context as _, Result};
use candle_core::Tensor;
use nalgebra::Vector3;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::num::NonZeroUsize;
use wm_metrics::findings::PlanTime;
use wm_planner::{
    Arrival, Coordinate, Dynamics, PlannedActions, PlannerChoice, Problem, Range, SearchSpace,
    StepsToGoal, Subgoals, TransitionDynamics, Waypoint, Weights, one_per_step,
};
use wm_sim::{EndEffectorAction, Environment};
use wm_zoo::subgoals::SubgoalSampling;

use super::{
    controller::Controller,
    model::Model,
    settings::{ClosedLoopSettings, Goals},
    simulator::Simulator,
};

/// Index of the gripper in an action of the arm.
const GRIPPER: usize = 6;

/// A controller in an environment.
pub struct Actor<'a> {
    settings: &'a ClosedLoopSettings,
    acts: ActorKind<'a>,
    rng: ChaCha8Rng,
}

enum ActorKind<'a> {
    Oracle,
    Hold,
    Random(&'a Model),
    Plans(Box<PlannerState<'a>>),
}

/// A planner's memory of an episode.
struct PlannerState<'a> {
    model: &'a Model,
    choice: PlannerChoice,
    is_perfect: bool,
    /// Latents to reach in order, one per model step.
    goals: Vec<Tensor>,
    at: Waypoint,
    /// Latents of the last two model steps, and the action (1, A) between them.
    seen: Vec<Tensor>,
    done: Option<Tensor>,
    last: Option<PlannedActions>,
    seed: u64,
    plans: Vec<PlanTime>,
}

impl<'a> Actor<'a> {
    /// Starts an episode; only the oracle and `hold` need no `model`.
    pub fn new(
        controller: Controller,
        is_perfect: bool,
        model: Option<&'a Model>,
        settings: &'a ClosedLoopSettings,
        (environment, seed): (&mut Environment, u64),
    ) -> Result<Self> {
        let needed = || model.context("this planner needs a model");
        let acts = match controller {
            Controller::Oracle => ActorKind::Oracle,
            Controller::Hold => ActorKind::Hold,
            Controller::Random => ActorKind::Random(needed()?),
            Controller::Planner(choice) => {
                let model = needed()?;
                let every = NonZeroUsize::new(model.frames_per_step()).context("no frames")?;
                let goals = match settings.goals {
                    Goals::Final => vec![model.encode(&environment.goal().picture)?],
                    Goals::Subgoals => {
                        let subgoals = environment.subgoals(every);
                        let latents = subgoals.iter().map(|goal| model.encode(&goal.picture));
                        latents.collect::<Result<_>>()?
                    }
                };
                ActorKind::Plans(Box::new(PlannerState {
                    model,
                    choice,
                    is_perfect,
                    goals,
                    at: Waypoint::default(),
                    seen: Vec::new(),
                    done: None,
                    last: None,
                    seed,
                    plans: Vec::new(),
                }))
            }
        };
        Ok(Self {
            settings,
            acts,
            rng: ChaCha8Rng::seed_from_u64(seed),
        })
    }

    /// Acts for one model step, or for the executed steps of a plan.
    pub fn act(&mut self, environment: &mut Environment, frames: usize) -> Result<()> {
        match &mut self.acts {
            ActorKind::Oracle => {
                for _ in 0..frames {
                    let command = environment.oracle();
                    environment.step(&command)?;
                }
            }
            ActorKind::Hold => {
                rest(environment, frames)?;
            }
            ActorKind::Random(model) => {
                let bounds = model.world.encoding.bounds();
                let drawn = bounds
                    .iter()
                    .map(|(low, high)| self.rng.random_range(*low..=*high));
                for command in model.commands(&drawn.collect::<Vec<f32>>())? {
                    environment.step(&command)?;
                }
            }
            ActorKind::Plans(planning) => planning.act(environment, self.settings)?,
        }
        Ok(())
    }

    /// Costs of its plans.
    pub fn plans(self) -> Vec<PlanTime> {
        match self.acts {
            ActorKind::Plans(planning) => planning.plans,
            _ => Vec::new(),
        }
    }
}

/// Holds still, and returns the actions.
pub fn rest(environment: &mut Environment, frames: usize) -> Result<Vec<EndEffectorAction>> {
    let still = EndEffectorAction {
        translation: Vector3::zeros(),
        rotation: Vector3::zeros(),
        gripper: environment.world().opening().round(),
    };
    let done = (0..frames).map(|_| Ok(environment.step(&still)?));
    done.collect()
}

impl PlannerState<'_> {
    fn act(&mut self, environment: &mut Environment, settings: &ClosedLoopSettings) -> Result<()> {
        if self.seen.is_empty() {
            // A model trained on motion always needs two frames.
            self.observe(environment)?;
            let done = rest(environment, self.model.frames_per_step())?;
            self.done = Some(self.model.action(&done)?);
        }
        let started = Instant::now();
        self.observe(environment)?;
        let found = self.plan(environment, settings, started)?;
        self.plans.push(PlanTime {
            ms: started.elapsed().as_secs_f64() * 1e3,
            candidates: found.candidates,
        });
        let space = self.space(environment, settings)?;
        let execute = settings.execute.min(found.actions.len());
        for (index, action) in found.actions.iter().take(execute).enumerate() {
            let mut done = Vec::new();
            for command in self.model.commands(&space.whole(action))? {
                done.push(environment.step(&command)?);
            }
            self.done = Some(self.model.action(&done)?);
            if index + 1 < execute {
                self.observe(environment)?;
            }
        }
        self.last = found.without(execute);
        Ok(())
    }

    fn observe(&mut self, environment: &mut Environment) -> Result<()> {
        let latent = self.model.encode(&environment.picture())?;
        self.seen.push(latent);
        if self.seen.len() > 2 {
            self.seen.remove(0);
        }
        Ok(())
    }

    fn plan(
        &mut self,
        environment: &Environment,
        settings: &ClosedLoopSettings,
        started: Instant,
    ) -> Result<PlannedActions> {
        let observed = self.seen.last().context("expected an observation")?.clone();
        let goals = self.goals_from(&observed, settings)?;
        let last = goals.last().context("expected a goal")?.clone();
        let goals = match self.choice.needs_subgoals() {
            true => self.along_subgoals(&observed, &goals, settings)?,
            false => goals,
        };
        let planner = self
            .choice
            .build(&settings.planner, self.model.idm.as_ref(), &goals)?;
        let space = self.space(environment, settings)?;
        let weights = Weights {
            goal: settings.last_step,
            path: settings.all_steps,
            action: settings.action,
            smoothness: settings.smoothness,
        };
        let mut objective = weights.objective(&one_per_step(&goals, settings.horizon), None)?;
        if settings.steps_to_goal > 0.0 {
            let distance = self.model.distance.as_ref().context(
                "steps_to_goal needs a learnt distance; train one with wm train distance",
            )?;
            let steps = StepsToGoal::new(Arc::clone(distance), last);
            objective = objective.and(settings.steps_to_goal, steps);
        }
        let (mut simulator, mut transition);
        let dynamics: &mut dyn Dynamics = if self.is_perfect {
            simulator = Simulator {
                environment: environment.clone(),
                model: self.model,
                observed,
            };
            &mut simulator
        } else {
            let world = &self.model.world;
            let context = Tensor::stack(&self.seen, 0)?.unsqueeze(0)?;
            let sampler = &world.transition.config().sampler;
            transition = TransitionDynamics::new(
                &world.transition,
                sampler,
                &context,
                self.done.as_ref(),
                self.seed,
            )?;
            &mut transition
        };
        let mut problem = Problem {
            space: &space,
            dynamics,
            objective: &objective,
            horizon: settings.horizon,
            batch: settings.batch,
            proposals: self
                .last
                .take()
                .map(|last| last.proposals())
                // Before the first plan there are no proposals.
                .unwrap_or_default(),
            workers: None,
        };
        let deadline = u128::from(settings.deadline_ms);
        let found = planner.plan(&mut problem, self.seed, &mut |_| {
            deadline > 0 && started.elapsed().as_millis() >= deadline
        })?;
        self.seed = self.seed.wrapping_add(1);
        Ok(found)
    }

    /// Latents on the way to the next of `goals`, one per step of a plan.
    fn along_subgoals(
        &self,
        observed: &Tensor,
        goals: &[Tensor],
        settings: &ClosedLoopSettings,
    ) -> Result<Vec<Tensor>> {
        let model = self.model.subgoals.as_ref().with_context(|| {
            format!(
                "the planner {} needs a model of subgoals; train one with wm train subgoals",
                self.choice
            )
        })?;
        let goal = goals.first().context("expected a goal")?;
        let sampling = SubgoalSampling::of(self.seed, settings.subgoal_steps);
        let subgoals = Subgoals::propose(model, (observed, goal), sampling)?;
        Ok(subgoals.goals(settings.horizon).latents().to_vec())
    }

    /// The remaining latents to reach, in order.
    fn goals_from(
        &mut self,
        observed: &Tensor,
        settings: &ClosedLoopSettings,
    ) -> Result<Vec<Tensor>> {
        let arrival = Arrival {
            share: settings.arrival,
            steps: settings.wait as f32,
        };
        let passed = if self.plans.is_empty() { 0.0 } else { 1.0 };
        self.at = self.at.advance(passed, &self.goals, observed, arrival)?;
        // `advance` never passes the last goal.
        Ok(self.goals.get(self.at.index..).unwrap_or_default().to_vec())
    }

    fn space(
        &self,
        environment: &Environment,
        settings: &ClosedLoopSettings,
    ) -> Result<SearchSpace> {
        let encoding = &self.model.world.encoding;
        let mut base = vec![0.0; encoding.action_dim()];
        let is_open = environment.world().opening() > 0.5;
        if let Some(gripper) = base.get_mut(GRIPPER) {
            *gripper = self.model.gripper(is_open)?;
        }
        let mut coordinates = Vec::new();
        for (index, (low, high)) in encoding.bounds().into_iter().enumerate() {
            let range = if index == GRIPPER {
                if !settings.gripper {
                    continue;
                }
                let (open, closed) = (self.model.gripper(true)?, self.model.gripper(false)?);
                Range::Either(open.min(closed), open.max(closed))
            } else {
                Range::Between(low, high)
            };
            coordinates.push(Coordinate {
                index,
                range,
                rate: f32::INFINITY,
            });
        }
        Ok(SearchSpace::new(base, coordinates)?)
    }
}
