//! How fast this machine predicts with the embedded default: a whole rollout from a full context, its first step, and
//! the transition model's steps alone, on the threads of rayon (`RAYON_NUM_THREADS` sets how many).
//!
//! ```text
//! cargo run --release -p wm_model --example rollout_speed
//! ```

use std::time::Instant;

use candle_core::{DType, Device, Tensor};
use wm_model::{Compute, Result, random, sampler::Rollout, trained_folder::TrainedFolder};

const RUNS: usize = 30;
const HORIZON: usize = 8;

fn percentile(times: &mut [f64], percent: usize) -> f64 {
    times.sort_by(f64::total_cmp);
    times
        .get(times.len() * percent / 100)
        .copied()
        .unwrap_or(f64::NAN)
        * 1e3
}

fn main() -> Result<()> {
    let model = TrainedFolder::named("tiny")
        .world_model(&Compute::default())?
        .transition;
    let c = model.config();
    let context = random::normal(&[1, 2, c.latent_height, c.latent_width, c.channels], 1)?;
    let past = Tensor::zeros((1, c.action_dim), DType::F32, &Device::Cpu)?;
    let action = Tensor::zeros((1, c.action_dim), DType::F32, &Device::Cpu)?;
    let (mut first, mut whole) = (Vec::new(), Vec::new());
    for _ in 0..RUNS {
        let start = Instant::now();
        let mut rollout = Rollout::new(&model, &c.sampler, &context, Some(&past), 1)?;
        for step in 0..HORIZON {
            rollout.next(&action)?;
            if step == 0 {
                first.push(start.elapsed().as_secs_f64());
            }
        }
        whole.push(start.elapsed().as_secs_f64());
    }
    for (name, times) in [("first step", &mut first), ("8 steps", &mut whole)] {
        println!(
            "{name:10}: p50 {:.1} ms, p95 {:.1} ms ({RUNS} runs)",
            percentile(times, 50),
            percentile(times, 95)
        );
    }
    Ok(())
}
