//! `wm model check`.

use crate::output::print;
use anyhow::Result;
use clap::Args;
use std::fmt::Write as _;
use std::time::{Duration, Instant};
use wm_doctor::Parts;
use wm_program::progress::Progress;
use wm_zoo::ModelFolder;
use wm_zoo::folder::Summary;

/// Loads a world model as the nodes do, runs it once, and prints its properties.
#[derive(Args, Debug)]
pub(crate) struct CheckCommand {
    /// A model folder, or `tiny`, as for the parameter `model` of a node
    #[arg(value_name = "DIR")]
    model: String,
    /// Rate of the camera that the verdict is for
    #[arg(long, value_name = "HZ", default_value_t = 5.0, value_parser = parse_rate)]
    rate: f64,
}

/// The nodes accept the periods of these rates as `frame_period`.
fn parse_rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (1.0 / 60.0..=1000.0).contains(&rate) => Ok(rate),
        _ => Err("expected a rate in Hz, from 1/60 to 1000".to_owned()),
    }
}

impl CheckCommand {
    pub(crate) fn run(self) -> Result<()> {
        let model = ModelFolder::open(&self.model)?;
        if let Some(folder) = model.described() {
            print(format_args!("{}", table(&folder.summary()?)?))?;
        }
        let started = Instant::now();
        let progress = Progress::open_ended("loading", "parts");
        let parts = Parts::load(&model)?;
        drop(progress);
        let loading = milliseconds(started.elapsed());
        let space = parts.encoder.space();
        print(format_args!("latent space {space}\n  {}\n", space.hash))?;
        match &parts.transition {
            Some(model) => print(format_args!(
                "transition {} on {}\n",
                model.hash,
                model.transition.place()
            ))?,
            None => print("no transition: encoder and decoder only\n")?,
        }
        for mark in model.unfinished()? {
            print(format_args!(
                "the training of its {} is {mark}\n",
                mark.part
            ))?;
        }
        print(format_args!("loaded in {loading:.0} ms\n"))?;
        print(format_args!(
            "{}",
            run_once(&parts, Duration::from_secs_f64(1.0 / self.rate))?
        ))
    }
}

/// The parts and the shapes of their outputs.
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
        views => format!(", {views} views side by side"),
    };
    writeln!(
        text,
        "GFLOPs: encoder, adapter, decoder for a 256x256 frame, transition for an Euler step, probe for its longest episode, its text tower for an instruction"
    )?;
    writeln!(
        text,
        "pictures {height}x{width}{views}, fit {}; latents {rows}x{columns}x{channels}, {} KiB in f16",
        summary.fit,
        rows * columns * channels * 2 / 1024
    )?;
    if let Some(stepping) = &summary.stepping {
        writeln!(
            text,
            "a model step is {} camera frames, sampled in {} Euler steps with time shift {:.3}; the context window has \
             at most {} frames",
            stepping.frame_skip, stepping.integration_steps, stepping.shift, stepping.max_frames
        )?;
    }
    Ok(text)
}

/// Runs one picture through all parts: their durations, and whether they are fast enough for a camera with
/// `frame_period` between frames.
fn run_once(parts: &Parts, frame_period: Duration) -> Result<String> {
    let progress = Progress::open_ended("running each part", "parts");
    let trial = parts.try_out()?;
    drop(progress);
    let mut text = String::new();
    line(&mut text, "encode a frame", trial.encode)?;
    match trial.predict {
        None => writeln!(text, "no transition: no predictions")?,
        Some(time) => line(&mut text, "predict a frame", time)?,
    }
    match trial.decode {
        None => writeln!(text, "no decoder: no pictures")?,
        Some(time) => line(&mut text, "decode a frame", time)?,
    }
    match trial.judge {
        None => writeln!(text, "no probe: no success probabilities")?,
        Some(judge) => writeln!(
            text,
            "read an instruction {:>8.1} ms\njudge two frames  {:>10.1} ms, of at most {} frames",
            milliseconds(judge.reading),
            milliseconds(judge.judging),
            judge.max_frames
        )?,
    }
    writeln!(text, "{}", trial.at(frame_period))?;
    Ok(text)
}

fn line(text: &mut String, what: &str, time: Duration) -> std::fmt::Result {
    writeln!(text, "{what:<18}{:>10.1} ms", milliseconds(time))
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embedded_default_runs() {
        let model = ModelFolder::open("tiny").unwrap();
        let parts = Parts::load(&model).unwrap();
        let text = run_once(&parts, Duration::from_secs(1)).unwrap();
        assert_eq!(text.lines().count(), 9, "{text}");
        for part in ["encoder: ", "predictor: ", "decoder: ", "for 1 Hz: "] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn rates_match_the_nodes_limits() {
        assert_eq!(parse_rate("2.5"), Ok(2.5));
        for wrong in ["0", "-5", "1e9", "nan", "fast"] {
            assert!(parse_rate(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn folder_without_transition_has_encoder_and_decoder() {
        let folder = tempfile::tempdir().unwrap();
        let autoencoder =
            wm_model::Autoencoder::random(wm_model::autoencoder::AutoencoderConfig::tiny(), 1)
                .unwrap();
        autoencoder
            .save(
                folder.path().join("autoencoder.safetensors"),
                wm_model::weights::Precision::F16,
            )
            .unwrap();
        let model = ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
        let parts = Parts::load(&model).unwrap();
        assert!(parts.transition.is_none());
        let text = run_once(&parts, Duration::from_secs(1)).unwrap();
        assert!(text.contains("encoder and decoder only"), "{text}");

        // a damaged transition is an error
        std::fs::write(folder.path().join("transition.safetensors"), "x").unwrap();
        assert!(Parts::load(&model).is_err());
    }
}
