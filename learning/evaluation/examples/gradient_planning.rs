//! Whether gradient descent on the actions pays in planning, with the embedded default: what a gradient step costs in
//! evaluations of candidates, and what descent and the searches come to in the same situations.
//!
//! The differentiable model is [`Transition`], as in training; the searches roll out the packed one, which has no gradient.
//! Both predict the same, which is checked. Descent is Adam on the searched values, cut off at their limits, from no motion
//! or from what the inverse dynamics model tells; the best of all its steps counts, as in a search.
//!
//! ```text
//! cargo run --release -p wm_evaluation --example gradient_planning
//! ```

use std::{num::NonZeroUsize, sync::Arc, time::Instant};

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor, Var};
use nalgebra::Vector3;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use wm_model::{
    Encoder, WorldModel,
    transition::{TemporalPattern, Transition},
};
use wm_planner::{
    Coordinate, Dynamics as _, IcemSettings, Objective, PlannerChoice, PlannerSettings, Problem,
    Range, SearchSpace, Target, TransitionDynamics,
};
use wm_sim::{EndEffectorAction, Environment, GoalKind, Variety};
use wm_zoo::{ModelFolder, idm::TrainedIdm};

/// Situations: the starts of reaches that the model was not trained on.
const SITUATIONS: u64 = 20;
const SEED: u64 = 5_000_000;
/// Runs of each timing.
const RUNS: usize = 20;
/// Index of the gripper in an action of the arm: binary, so that nothing descends there.
const GRIPPER: usize = 6;
/// Descents: steps, and Adam's rate \[model units\].
const DESCENTS: [(usize, f64); 4] = [(5, 0.3), (5, 0.1), (20, 0.3), (20, 0.1)];
/// How far the two models may differ, of latents of variance 1: rounding.
const AGREE: f32 = 1e-3;

/// A plan, (k, searched values), and its cost.
type Found = (Vec<Vec<f32>>, f32);

struct Models {
    encoder: Box<dyn Encoder>,
    world: WorldModel,
    transition: Transition,
    idm: Option<Arc<TrainedIdm>>,
}

/// What is seen, and what is to be seen.
struct Situation {
    environment: Environment,
    /// Two latents (h, w, C), and the action (1, A) between them.
    observed: [Tensor; 2],
    past: Tensor,
    /// (h, w, C).
    goal: Tensor,
    /// Where the goal's picture shows the tool \[m\].
    goal_position: Vector3<f64>,
}

/// What came of a method in all situations.
#[derive(Default)]
struct Score {
    ms: Vec<f64>,
    /// Cost of the plan, as a share of that of no motion.
    cost: f64,
    /// What the plan leaves of the way to the goal \[m\].
    left_m: f64,
}

impl Models {
    fn load() -> Result<Self> {
        let folder = ModelFolder::open("tiny")?;
        let tensors = folder.transition_tensors()?;
        let transition = Transition::build(tensors.config, &mut |parameter| {
            let tensor = tensors.tensors.get(&parameter.name).cloned();
            tensor.ok_or_else(|| wm_model::Error::config("weights", parameter.name.clone()))
        })?;
        Ok(Self {
            encoder: folder.encoder()?,
            world: folder.world_model()?,
            transition,
            idm: folder.idm()?.map(Arc::new),
        })
    }

    fn encode(&self, environment: &mut Environment) -> Result<Tensor> {
        let pixels = self.encoder.prepare(&environment.picture())?;
        Ok(self.encoder.encode(&pixels)?.squeeze(0)?)
    }

    fn situation(&self, seed: u64) -> Result<Situation> {
        let mut environment = Environment::new(GoalKind::Reach, seed, &Variety::default())?;
        let frames = self.world.encoding.frame_skip();
        let every = NonZeroUsize::new(frames).context("no frames")?;
        // The picture of the solution two model steps on: within what a short plan attains.
        let subgoals = environment.subgoals(every);
        let goal = subgoals.get(1).or(subgoals.last()).context("no solution")?;
        let goal_position = goal.world.tool().position;
        let pixels = self.encoder.prepare(&goal.picture)?;
        let goal = self.encoder.encode(&pixels)?.squeeze(0)?;
        let first = self.encode(&mut environment)?;
        let still = EndEffectorAction::still(environment.world().opening().round());
        let done: Vec<[f32; 7]> = (0..frames)
            .map(|_| Ok(environment.step(&still)?.values()))
            .collect::<Result<_>>()?;
        let past = self.world.encoding.encode_step(&done)?.values;
        let second = self.encode(&mut environment)?;
        let shape = (1, past.len());
        Ok(Situation {
            environment,
            observed: [first, second],
            past: Tensor::from_vec(past, shape, &Device::Cpu)?,
            goal,
            goal_position,
        })
    }

    /// Where actions (1, k, A) lead on the tape: (k, h, w, C). `frames` of the context are seen.
    fn roll_out(&self, situation: &Situation, actions: &Tensor, frames: usize) -> Result<Tensor> {
        let config = self.transition.config();
        let sampler = &config.sampler;
        let rest = Tensor::zeros_like(&situation.past)?;
        let seen = situation.observed.iter().map(|latent| latent.unsqueeze(0));
        let mut seen = seen.collect::<candle_core::Result<Vec<_>>>()?;
        let mut fed = vec![rest, situation.past.clone()];
        seen.drain(..2 - frames);
        fed.drain(..2 - frames);
        let mut predicted = Vec::new();
        for step in 0..actions.dim(1)? {
            fed.push(actions.narrow(1, step, 1)?.squeeze(1)?);
            let mut x = self.noise(step)?;
            let levels = sampler.levels();
            for (from, to) in levels.iter().zip(levels.iter().skip(1)) {
                let count = seen.len() + 1;
                let mut taus = vec![sampler.context_tau as f32; count];
                if let Some(last) = taus.last_mut() {
                    *last = *from as f32;
                }
                let taus = Tensor::from_vec(taus, (1, count), &Device::Cpu)?;
                let previous = seen.last().context("a frame before")?.unsqueeze(1)?;
                let frames: Vec<Tensor> = seen.iter().cloned().chain([x.clone()]).collect();
                let (frames, fed) = (Tensor::stack(&frames, 1)?, Tensor::stack(&fed, 1)?);
                let pattern = TemporalPattern::causal(count);
                let output = self.transition.output(&frames, &taus, &fed, &pattern, 1)?;
                let tau = taus.narrow(1, count - 1, 1)?;
                let velocity =
                    config
                        .parametrisation
                        .velocity(&output, &x.unsqueeze(1)?, &tau, &previous)?;
                x = (x - (velocity.squeeze(1)? * (from - to))?)?;
            }
            predicted.push(x.squeeze(0)?);
            seen.push(x);
        }
        Ok(Tensor::stack(&predicted, 0)?)
    }

    /// The noise of a step, as the sampler draws it.
    fn noise(&self, step: usize) -> Result<Tensor> {
        let c = self.transition.config();
        let shape = (1, c.latent_height, c.latent_width, c.channels);
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        rng.set_stream(step as u64);
        let count = c.latent_height * c.latent_width * c.channels;
        let values = (0..count).map(|_| StandardNormal.sample(&mut rng));
        Ok(Tensor::from_vec(
            values.collect::<Vec<f32>>(),
            shape,
            &Device::Cpu,
        )?)
    }

    fn dynamics<'m>(&'m self, situation: &Situation) -> Result<TransitionDynamics<'m>> {
        let context = Tensor::stack(&situation.observed, 0)?.unsqueeze(0)?;
        let model = &self.world.transition;
        let (sampler, past) = (&model.config().sampler, Some(&situation.past));
        Ok(TransitionDynamics::new(
            model, sampler, &context, past, SEED,
        )?)
    }

    fn space(&self, situation: &Situation) -> Result<SearchSpace> {
        let bounds = self.world.encoding.bounds().into_iter().enumerate();
        let coordinates = bounds.filter(|(index, _)| *index != GRIPPER);
        let coordinates = coordinates.map(|(index, (low, high))| Coordinate {
            index,
            range: Range::Between(low, high),
            rate: f32::INFINITY,
        });
        // The gripper as it was in the observed step, nothing else of it.
        let mut base = situation.past.flatten_all()?.to_vec1::<f32>()?;
        for (index, value) in base.iter_mut().enumerate() {
            if index != GRIPPER {
                *value = 0.0;
            }
        }
        Ok(SearchSpace::new(base, coordinates.collect())?)
    }

    /// The mean squared latent error after the last step.
    fn loss(&self, situation: &Situation, actions: &Tensor) -> Result<Tensor> {
        let latents = self.roll_out(situation, actions, 2)?;
        let last = latents.get(latents.dim(0)? - 1)?;
        Ok((last - &situation.goal)?.sqr()?.mean_all()?)
    }

    /// Adam from `plan` (k, searched values): the best of all steps, and its cost.
    fn descend(
        &self,
        situation: &Situation,
        plan: &[Vec<f32>],
        (steps, rate): (usize, f64),
    ) -> Result<Found> {
        let space = self.space(situation)?;
        let mut plan = plan.to_vec();
        let count = plan.len() * space.len();
        let (mut first, mut second) = (vec![0.0_f64; count], vec![0.0_f64; count]);
        let mut best: Option<Found> = None;
        for step in 0..=steps {
            let whole: Vec<f32> = plan.iter().flat_map(|action| space.whole(action)).collect();
            let shape = (1, plan.len(), space.action_dim());
            let variable = Var::from_vec(whole, shape, &Device::Cpu)?;
            let loss = self.loss(situation, variable.as_tensor())?;
            let cost = loss.to_scalar::<f32>()?;
            if best.as_ref().is_none_or(|(_, least)| cost < *least) {
                best = Some((plan.clone(), cost));
            }
            if step == steps {
                break;
            }
            let gradients = loss.backward()?;
            let gradient = gradients.get(&variable).context("no gradient")?;
            let gradient = gradient.squeeze(0)?.to_vec2::<f32>()?;
            let gradient = gradient.iter().flat_map(|whole| space.searched(whole));
            let limits = space.coordinates().iter().map(|own| own.range.bounds());
            let values = plan.iter_mut().flatten().zip(limits.cycle());
            let moments = first.iter_mut().zip(&mut second);
            for (((value, (low, high)), (first, second)), gradient) in
                values.zip(moments).zip(gradient)
            {
                let gradient = f64::from(gradient);
                *first = 0.9 * *first + 0.1 * gradient;
                *second = 0.999 * *second + 0.001 * gradient * gradient;
                // Adam's corrections of the first steps, of which there are few.
                let at = step as i32 + 1;
                let mean = *first / (1.0 - 0.9_f64.powi(at));
                let size = (*second / (1.0 - 0.999_f64.powi(at))).sqrt();
                *value = (*value - (rate * mean / (size + 1e-12)) as f32).clamp(low, high);
            }
        }
        best.context("no step")
    }

    /// What a planner finds: its plan and cost.
    fn search(
        &self,
        situation: &Situation,
        choice: PlannerChoice,
        settings: &PlannerSettings,
        horizon: usize,
    ) -> Result<Found> {
        let goals = [situation.goal.clone()];
        let planner = choice.build(settings, self.idm.as_ref(), &goals)?;
        let objective = Objective::of(Target::LastStep(situation.goal.clone()));
        let mut dynamics = self.dynamics(situation)?;
        let mut problem = Problem {
            space: &self.space(situation)?,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon,
            batch: 16,
            proposals: Vec::new(),
            workers: None,
        };
        let found = planner.plan(&mut problem, SEED, &mut |_| false)?;
        Ok((found.actions, found.cost))
    }

    /// What a plan leaves of the way to the goal, carried out \[m\].
    fn left_m(&self, situation: &Situation, plan: &[Vec<f32>]) -> Result<f64> {
        let space = self.space(situation)?;
        let frames = self.world.encoding.frame_skip();
        let mut environment = situation.environment.clone();
        for action in plan {
            let whole = self.world.encoding.decode_step(&space.whole(action))?;
            let part = |index: usize| {
                f64::from(whole.get(index).copied().unwrap_or_default()) / frames as f64
            };
            let command = EndEffectorAction {
                translation: Vector3::new(part(0), part(1), part(2)),
                rotation: Vector3::new(part(3), part(4), part(5)),
                gripper: part(GRIPPER) * frames as f64,
            };
            for _ in 0..frames {
                environment.step(&command)?;
            }
        }
        Ok((environment.world().tool().position - situation.goal_position).norm())
    }
}

/// Median of times \[ms\].
fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}

fn timed(mut run: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut times = Vec::new();
    for _ in 0..RUNS {
        let started = Instant::now();
        run()?;
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    Ok(median(&mut times))
}

/// What a gradient step costs beside an evaluation of a candidate.
fn costs(models: &Models, situation: &Situation, horizon: usize) -> Result<()> {
    let space = models.space(situation)?;
    let plan = vec![0.0; space.len()];
    let whole = space.whole(&plan).repeat(horizon);
    let shape = (1, horizon, space.action_dim());
    let actions = Tensor::from_vec(whole, shape, &Device::Cpu)?;
    let mut dynamics = models.dynamics(situation)?;
    let packed = dynamics.rollout(&actions)?.squeeze(0)?;
    let on_tape = models.roll_out(situation, &actions, 2)?;
    let apart = (packed - &on_tape)?.abs()?.max_all()?.to_scalar::<f32>()?;
    ensure!(apart < AGREE, "the two models differ by {apart}");

    let batch = actions.repeat((16, 1, 1))?;
    let candidate = timed(|| {
        dynamics.rollout(&batch)?;
        Ok(())
    })? / 16.0;
    let variable = Var::from_tensor(&actions)?;
    let step = |frames: usize| {
        timed(|| {
            let latents = models.roll_out(situation, variable.as_tensor(), frames)?;
            latents.sqr()?.mean_all()?.backward()?;
            Ok(())
        })
    };
    let (whole, least) = (step(2)?, step(1)?);
    println!(
        "horizon {horizon}: a candidate of 16 takes {candidate:.2} ms; a gradient step {whole:.1} ms, or {:.0} candidates; with \
         one frame of context {least:.1} ms, or {:.0}",
        whole / candidate,
        least / candidate
    );
    Ok(())
}

fn compare(models: &Models, situations: &[Situation], horizon: usize) -> Result<()> {
    let searches = |population, iterations, elites, std| PlannerSettings {
        icem: IcemSettings {
            population,
            iterations,
            elites,
            initial_std: std,
            ..IcemSettings::default()
        },
        ..PlannerSettings::default()
    };
    let print = |name: &str, mut score: Score| {
        let count = score.ms.len() as f64;
        println!(
            "horizon {horizon}, {name:<32} cost {:.3}, left {:5.1} mm, {:7.1} ms",
            score.cost / count,
            score.left_m / count * 1e3,
            median(&mut score.ms)
        );
    };
    let run = |method: &dyn Fn(&Situation) -> Result<Found>| -> Result<Score> {
        let mut score = Score::default();
        for situation in situations {
            let values = models.space(situation)?.len();
            let (_, still) =
                models.descend(situation, &vec![vec![0.0; values]; horizon], (0, 0.0))?;
            let started = Instant::now();
            let (plan, cost) = method(situation)?;
            score.ms.push(started.elapsed().as_secs_f64() * 1e3);
            score.cost += f64::from(cost / still);
            score.left_m += models.left_m(situation, &plan)?;
        }
        Ok(score)
    };
    for (name, choice, settings) in [
        ("idm", PlannerChoice::Idm, searches(12, 1, 4, 0.08)),
        (
            "idm+icem, 12",
            PlannerChoice::IdmIcem,
            searches(12, 1, 4, 0.08),
        ),
        (
            "idm+icem, 40 x 3",
            PlannerChoice::IdmIcem,
            searches(40, 3, 8, 0.08),
        ),
        (
            "icem, 40 x 3",
            PlannerChoice::Icem,
            searches(40, 3, 8, 0.25),
        ),
    ] {
        print(
            name,
            run(&|situation| models.search(situation, choice, &settings, horizon))?,
        );
    }
    for descent in DESCENTS {
        let (steps, rate) = descent;
        let from_rest = run(&|situation| {
            let values = models.space(situation)?.len();
            models.descend(situation, &vec![vec![0.0; values]; horizon], descent)
        })?;
        print(&format!("{steps} steps at {rate} from rest"), from_rest);
        let from_idm = run(&|situation| {
            let told = PlannerChoice::Idm;
            let (plan, _) = models.search(situation, told, &PlannerSettings::default(), horizon)?;
            models.descend(situation, &plan, descent)
        })?;
        print(&format!("{steps} steps at {rate} from idm"), from_idm);
    }
    Ok(())
}

fn main() -> Result<()> {
    let models = Models::load()?;
    let situations = (SEED..SEED + SITUATIONS).map(|seed| models.situation(seed));
    let situations = situations.collect::<Result<Vec<_>>>()?;
    let first = situations.first().context("a situation")?;
    for horizon in [1, 2, 4] {
        costs(&models, first, horizon)?;
    }
    for horizon in [1, 2] {
        compare(&models, &situations, horizon)?;
    }
    Ok(())
}
