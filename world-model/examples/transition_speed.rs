//! How long the transition model takes for one velocity: one new frame after cached ones, with random weights.
//!
//! ```text
//! cargo run --release -p wm_model --example transition_speed -- dit-s 32 32 16 2 f32 9 20
//! ```
//!
//! Preset, latent height, width and channels, patch, f32 or bf16, cached frames, runs; prints the runs' milliseconds,
//! a line each, for `benches/transition.py`.

use std::time::Instant;

use wm_model::ops::PackedFormat;
use wm_model::transition::{NewFrame, PackedTransition, Transition, TransitionConfig};
use wm_model::{Error, Result};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [preset, height, width, channels, patch, format, cached, runs] = arguments.as_slice()
    else {
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
            return Err(Error::config(
                "format",
                format!("`{other}`, expected f32 or bf16"),
            ));
        }
    };
    let latent = (number(height)?, number(width)?, number(channels)?);
    let config = TransitionConfig::preset(preset, latent, number(patch)?, 10)?;
    let model = PackedTransition::new(&Transition::random(config, 1)?, format)?;
    let values: Vec<f32> = (0..latent.0 * latent.1 * latent.2)
        .map(|i| (i as f32 * 0.7).sin())
        .collect();
    let frame = NewFrame {
        latents: &values,
        tau: &[0.5],
        action: &[0.1; 10],
    };
    let mut contexts = Vec::new();
    for _ in 0..number(cached)? {
        let earlier: Vec<_> = contexts.iter().collect();
        let mut pass = model.pass(&earlier, &[frame], 1, 1)?;
        contexts.append(&mut pass.contexts);
    }
    let earlier: Vec<_> = contexts.iter().collect();
    for _ in 0..number(runs)? {
        let start = Instant::now();
        model.pass(&earlier, &[frame], 0, 0)?;
        println!("{:.4}", start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(())
}
