//! How long the transition model takes, with random weights, for `benches/transition.py`.
//!
//! ```text
//! cargo run --release -p wm_model --example transition_speed -- velocity dit-s 32 32 16 2 f32 20
//! ```
//!
//! What is timed, preset, latent height, width and channels, patch, f32 or bf16, runs; prints the runs' milliseconds, a
//! line each. What is timed is one of
//!
//! - `velocity`: one velocity of a new frame after nine cached ones;
//! - `frame`: a predicted frame, ten Euler steps at the end of a full window of ten, its context computed too.

use std::time::Instant;

use candle_core::{Device, Tensor};
use wm_model::ops::PackedFormat;
use wm_model::sampler::Rollout;
use wm_model::transition::{
    FrameContext, NewFrame, PackedTransition, Transition, TransitionConfig,
};
use wm_model::{Error, Result};

const CACHED: usize = 9;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [what, preset, height, width, channels, patch, format, runs] = arguments.as_slice() else {
        return Err(Error::config("arguments", "see the top of this file"));
    };
    let number = |text: &String| {
        text.parse::<usize>()
            .map_err(|error| Error::config("arguments", format!("`{text}`: {error}")))
    };
    let format = match format.as_str() {
        "f32" => PackedFormat::F32,
        "bf16" => PackedFormat::Bf16,
        other => {
            let reason = format!("`{other}`, expected f32 or bf16");
            return Err(Error::config("format", reason));
        }
    };
    let latent = (number(height)?, number(width)?, number(channels)?);
    let config = TransitionConfig::preset(preset, latent, number(patch)?, 10)?;
    let model = PackedTransition::new(&Transition::random(config, 1)?, format)?;
    let mut run: Box<dyn FnMut() -> Result<()>> = match what.as_str() {
        "velocity" => velocity(&model)?,
        "frame" => frame(&model)?,
        other => {
            let reason = format!("`{other}`, expected velocity or frame");
            return Err(Error::config("what is timed", reason));
        }
    };
    for _ in 0..number(runs)? {
        let start = Instant::now();
        run()?;
        println!("{:.4}", start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(())
}

fn velocity(model: &PackedTransition) -> Result<Box<dyn FnMut() -> Result<()> + '_>> {
    let c = model.config();
    let values: Vec<f32> = (0..c.latent_height * c.latent_width * c.channels)
        .map(|i| (i as f32 * 0.7).sin())
        .collect();
    let mut contexts: Vec<FrameContext> = Vec::new();
    for _ in 0..CACHED {
        let earlier: Vec<_> = contexts.iter().collect();
        let mut pass = model.pass(&earlier, &[new_frame(&values)], 1, 1)?;
        contexts.append(&mut pass.contexts);
    }
    Ok(Box::new(move || {
        let earlier: Vec<_> = contexts.iter().collect();
        model.pass(&earlier, &[new_frame(&values)], 0, 0).map(drop)
    }))
}

fn new_frame(latents: &[f32]) -> NewFrame<'_> {
    NewFrame {
        latents,
        tau: &[0.5],
        action: &[0.1; 10],
    }
}

fn frame(model: &PackedTransition) -> Result<Box<dyn FnMut() -> Result<()> + '_>> {
    let c = model.config();
    let shape = (1, CACHED, c.latent_height, c.latent_width, c.channels);
    let context = Tensor::randn(0f32, 1.0, shape, &Device::Cpu)?;
    let past = Tensor::randn(0f32, 1.0, (CACHED - 1, c.action_dim), &Device::Cpu)?;
    let action = Tensor::randn(0f32, 1.0, (1, c.action_dim), &Device::Cpu)?;
    Ok(Box::new(move || {
        let mut rollout = Rollout::new(model, &c.sampler, &context, Some(&past), 1)?;
        rollout.next(&action).map(drop)
    }))
}
