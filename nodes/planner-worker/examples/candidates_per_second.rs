//! Measures how many candidates per second are costed, alone and with the workers at the given endpoints.
//!
//!     wm planner-worker --listen tcp/127.0.0.1:7447 & cargo run --release -p wm_planner_worker --example
//! candidates_per_second -- tcp/127.0.0.1:7447

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use candle_core::{DType, Device, Tensor};
use wm_model::trained_folder::EMBEDDED;
use wm_planner::{
    Cem, CemSettings, Objective, PlannedActions, Planner as _, Problem, SearchSpace, Target,
    TransitionDynamics, WorkerPool as _,
};
use wm_planner_worker::{Identity, PlannerWorkers};
use wm_ros::zenoh::{Mode, NetworkArguments};
use wm_zoo::ModelFolder;

/// Plans of each kind, in turn.
const PLANS: u64 = 20;
const POPULATION: usize = 96;
const BATCH: usize = 8;
const HORIZON: usize = 4;
/// How long to wait for workers.
const PATIENCE: Duration = Duration::from_secs(30);

fn main() -> Result<()> {
    let endpoints: Vec<String> = std::env::args().skip(1).collect();
    ensure!(!endpoints.is_empty(), "expected endpoints of workers");
    let model = ModelFolder::open(EMBEDDED)?.world_model()?;
    let expected = endpoints.len();
    let network = NetworkArguments {
        mode: Some(Mode::Peer),
        connect: endpoints,
        ..NetworkArguments::default()
    };
    let pool = PlannerWorkers::connect(&network, Identity::of(&model)?)?;
    let counts = pool.wait_until(PATIENCE, |counts| counts.taking_part == expected);
    ensure!(
        counts.taking_part == expected,
        "of {expected} workers: {counts:?}"
    );

    let (height, width, channels) = model.space.shape();
    let context = Tensor::zeros((1, 2, height, width, channels), DType::F32, &Device::Cpu)?;
    let values = model.encoding.action_dim();
    let past = Tensor::zeros((1, values), DType::F32, &Device::Cpu)?;
    let goal = Tensor::ones((height, width, channels), DType::F32, &Device::Cpu)?;
    let sampler = &model.transition.config().sampler;
    let mut dynamics =
        TransitionDynamics::new(&model.transition, sampler, &context, Some(&past), 1)?;
    let objective = Objective::of(Target::AllSteps(goal));
    let space = SearchSpace::bounded(&[(-1.0, 1.0); 3], values)?;
    let cem = Cem::new(CemSettings {
        population: POPULATION,
        iterations: 1,
        elites: 8,
        ..CemSettings::default()
    })?;
    let mut plan = |seed, pool: Option<&PlannerWorkers>| -> Result<(PlannedActions, f64)> {
        let started = Instant::now();
        let mut lent = pool.and_then(|pool| pool.share(&dynamics, &objective, &space, HORIZON));
        let mut problem = Problem {
            space: &space,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon: HORIZON,
            batch: BATCH,
            proposals: Vec::new(),
            workers: lent.as_deref_mut(),
        };
        let planned = cem.plan(&mut problem, seed, &mut |_| false)?;
        Ok((planned, POPULATION as f64 / started.elapsed().as_secs_f64()))
    };
    let (mut alone, mut shared) = (Vec::new(), Vec::new());
    for seed in 0..PLANS {
        let (own, rate) = plan(seed, None)?;
        alone.push(rate);
        let (theirs, rate) = plan(seed, Some(&pool))?;
        shared.push(rate);
        ensure!(own == theirs, "the plans of seed {seed} differ");
    }
    println!("candidates a second, n = {PLANS} plans of {POPULATION} by {BATCH}, {HORIZON} steps");
    for (name, rates) in [("alone", &mut alone), ("with workers", &mut shared)] {
        rates.sort_by(f64::total_cmp);
        let at = |part: usize| {
            rates
                .get(rates.len() * part / 100)
                .copied()
                .unwrap_or(f64::NAN)
        };
        println!(
            "{name:>12}: p50 {:.0} (p5 {:.0}, p95 {:.0})",
            at(50),
            at(5),
            at(95)
        );
    }
    println!("{:?}", pool.counts());
    Ok(())
}
