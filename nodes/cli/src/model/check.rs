//! `wm model check`.

use crate::output::print;
use anyhow::{Context as _, Result};
use candle_core::{DType, Device, Tensor};
use clap::Args;
use std::fmt::Write as _;
use std::time::Instant;
use wm_model::bundle::BundledTransition;
use wm_model::sampler::Rollout;
use wm_model::{Decoder, Encoder};
use wm_zoo::WorldModel;
use wm_zoo::folder::Summary;
use wm_zoo::success_probe::SuccessClassifier;

/// Loads a world model as the nodes do, runs it once, and says what it is.
#[derive(Args, Debug)]
pub struct CheckCommand {
    /// What a node's parameter `model` takes: a folder, or `tiny`
    #[arg(value_name = "DIR")]
    model: String,
}

impl CheckCommand {
    /// Runs it.
    pub fn run(self) -> Result<()> {
        let model = WorldModel::open(&self.model).with_context(|| self.model.clone())?;
        if let WorldModel::Folder(folder) = &model {
            print(format_args!("{}", table(&folder.summary()?)?))?;
        }
        let started = Instant::now();
        let encoder = model.encoder()?;
        let transition = model.transition()?;
        let decoder = model.decoder()?;
        let probe = model.probe()?;
        let loading = milliseconds(started);
        print(format_args!(
            "latent space {}\n  {}\ntransition {}\nloaded in {loading:.0} ms\n",
            encoder.space(),
            encoder.space().hash,
            transition.hash,
        ))?;
        print(format_args!(
            "{}",
            run_once(&*encoder, &transition, decoder.as_deref(), probe.as_ref())?
        ))
    }
}

/// The parts, and what they make of a picture.
fn table(summary: &Summary) -> Result<String> {
    let mut text = String::new();
    writeln!(
        text,
        "{:<18}{:<24}{:>14}{:>10}",
        "", "kind", "parameters [M]", "GFLOPs"
    )?;
    for part in &summary.parts {
        writeln!(
            text,
            "{:<18}{:<24}{:>14.3}{:>10.1}",
            part.role,
            part.kind,
            part.parameters as f64 / 1e6,
            part.operations as f64 / 1e9
        )?;
    }
    let ([height, width], [rows, columns, channels]) = (summary.image, summary.latent);
    let views = match summary.views {
        1 => String::new(),
        views => format!(", {views} views beside each other"),
    };
    writeln!(
        text,
        "GFLOPs: encoder, adapter, decoder for a 256x256 frame, transition for an Euler step, probe for its longest episode, its text tower for an instruction"
    )?;
    writeln!(
        text,
        "pictures {height}x{width}{views}; latents {rows}x{columns}x{channels}, {} KiB in f16",
        rows * columns * channels * 2 / 1024
    )?;
    writeln!(
        text,
        "a model step is {} camera frames, sampled in {} Euler steps with time shift {:.3}; at most {} frames are seen",
        summary.frame_skip, summary.integration_steps, summary.shift, summary.max_frames
    )?;
    Ok(text)
}

/// One picture through all parts, and how long each takes here.
fn run_once(
    encoder: &dyn Encoder,
    transition: &BundledTransition,
    decoder: Option<&dyn Decoder>,
    probe: Option<&SuccessClassifier>,
) -> Result<String> {
    let mut text = String::new();
    let (height, width) = encoder.input_size();
    let picture = Tensor::full(0.5f32, (1, height, width, 3), &Device::Cpu)?;
    let started = Instant::now();
    let latent = encoder.encode(&picture).context("encoding")?;
    writeln!(text, "encode a frame    {:>10.1} ms", milliseconds(started))?;

    let model = &transition.model;
    let context = latent.unsqueeze(0)?;
    let action = Tensor::zeros((1, model.config().action_dim), DType::F32, &Device::Cpu)?;
    let started = Instant::now();
    let mut rollout = Rollout::new(model, &model.config().sampler, &context, None, 0)?;
    let next = rollout.next(&action).context("predicting")?;
    writeln!(text, "predict a frame   {:>10.1} ms", milliseconds(started))?;

    match decoder {
        None => writeln!(text, "no decoder: there will be no pictures")?,
        Some(decoder) => {
            let started = Instant::now();
            decoder.decode(&next).context("decoding")?;
            writeln!(text, "decode a frame    {:>10.1} ms", milliseconds(started))?;
        }
    }
    match probe {
        None => writeln!(text, "no probe: there will be no success probabilities")?,
        Some(probe) => {
            let started = Instant::now();
            let instruction = probe
                .instruction("put the cup on the plate")
                .context("reading an instruction")?;
            let reading = milliseconds(started);
            let episode = Tensor::cat(&[&latent, &next], 0)?;
            let started = Instant::now();
            probe
                .probability(&episode, &instruction)
                .context("the success probe")?;
            writeln!(
                text,
                "read an instruction {reading:>8.1} ms\njudge two frames  {:>10.1} ms, of at most {} frames",
                milliseconds(started),
                probe.max_frames()
            )?;
        }
    }
    Ok(text)
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_default_runs() {
        let model = WorldModel::open("tiny").unwrap();
        let (encoder, transition) = (model.encoder().unwrap(), model.transition().unwrap());
        let decoder = model.decoder().unwrap();
        let text = run_once(&*encoder, &transition, decoder.as_deref(), None).unwrap();
        assert_eq!(text.lines().count(), 4, "{text}");
    }
}
