//! Times plans of CEM with the embedded default, on the threads of rayon (`RAYON_NUM_THREADS` sets how many).
//!
//! ```text
//! cargo run --release -p wm_planner --example plan_speed -- PLANS POPULATION ITERATIONS HORIZON
//! ```
//!
//! Prints the milliseconds of each plan as a JSON array. `benches/lewm.py` compares them with another planner's.

use std::time::Instant;

use candle_core::{DType, Device, Tensor};
use wm_model::{Compute, random, trained_folder::TrainedFolder};
use wm_planner::{
    Cem, CemSettings, Objective, Planner as _, Problem, SearchSpace, Target, TransitionDynamics,
};

/// Candidates that one thread predicts at once.
const BATCH: usize = 8;
/// Elites of an iteration, as stable-worldmodel's.
const ELITES: usize = 30;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let numbers = std::env::args().skip(1).map(|number| number.parse());
    let numbers: Vec<usize> = numbers.collect::<Result<_, _>>()?;
    let [plans, population, iterations, horizon] = *numbers.as_slice() else {
        return Err("expected PLANS POPULATION ITERATIONS HORIZON".into());
    };
    let model = TrainedFolder::named("tiny").world_model(&Compute::default())?;
    let (height, width, channels) = model.space.shape();
    let context = random::normal(&[1, 2, height, width, channels], 1)?;
    let values = model.encoding.action_dim();
    let past = Tensor::zeros((1, values), DType::F32, &Device::Cpu)?;
    let goal = random::normal(&[height, width, channels], 2)?;
    let objective = Objective::of(Target::LastStep(goal));
    let space = SearchSpace::bounded(&vec![(-1.0, 1.0); values], values)?;
    let cem = Cem::new(CemSettings {
        population,
        iterations,
        elites: ELITES,
        ..CemSettings::default()
    })?;
    let mut times = Vec::new();
    for seed in 0..plans as u64 {
        let started = Instant::now();
        let sampler = &model.transition.config().sampler;
        let mut dynamics =
            TransitionDynamics::new(&model.transition, sampler, &context, Some(&past), seed)?;
        let mut problem = Problem {
            space: &space,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon,
            batch: BATCH,
            proposals: Vec::new(),
            workers: None,
        };
        cem.plan(&mut problem, seed, &mut |_| false)?;
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    println!("{times:?}");
    Ok(())
}
