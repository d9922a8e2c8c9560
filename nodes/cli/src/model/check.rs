//! `wm model check`.

mod verdict;

use crate::output::print;
use anyhow::{Context as _, Result};
use candle_core::{DType, Device, Tensor};
use clap::Args;
use std::fmt::Write as _;
use std::time::{Duration, Instant};
use verdict::Times;
use wm_model::WorldModel;
use wm_model::sampler::Rollout;
use wm_model::{Decoder, Encoder};
use wm_zoo::ModelFolder;
use wm_zoo::folder::Summary;
use wm_zoo::success_probe::SuccessClassifier;

/// An instruction to try a success probe with that reads any text.
const TASK: &str = "put the cup on the plate";

/// Loads a world model as the nodes do, runs it once, and says what it is.
#[derive(Args, Debug)]
pub struct CheckCommand {
    /// A model folder, or `tiny`, as for the parameter `model` of a node
    #[arg(value_name = "DIR")]
    model: String,
    /// Rate of the camera that the verdict is for
    #[arg(long, value_name = "HZ", default_value_t = 5.0, value_parser = parse_rate)]
    rate: f64,
}

/// Rates whose period the nodes take as `frame_period`.
fn parse_rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (1.0 / 60.0..=1000.0).contains(&rate) => Ok(rate),
        _ => Err("expected a rate in Hz, from 1/60 to 1000".to_owned()),
    }
}

impl CheckCommand {
    /// Runs it.
    pub fn run(self) -> Result<()> {
        let model = ModelFolder::open(&self.model)?;
        if let ModelFolder::Described(folder) = &model {
            print(format_args!("{}", table(&folder.summary()?)?))?;
        }
        let started = Instant::now();
        let parts = Parts::load(&model)?;
        let loading = milliseconds(started);
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
        print(format_args!("loaded in {loading:.0} ms\n"))?;
        print(format_args!(
            "{}",
            run_once(&parts, Duration::from_secs_f64(1.0 / self.rate))?
        ))
    }
}

/// What of a model there is, loaded.
struct Parts {
    encoder: Box<dyn Encoder>,
    transition: Option<WorldModel>,
    decoder: Option<Box<dyn Decoder>>,
    probe: Option<SuccessClassifier>,
}

impl Parts {
    fn load(model: &ModelFolder) -> Result<Self> {
        Ok(Self {
            encoder: model.encoder()?,
            transition: match model.has_transition() {
                true => Some(model.world_model()?),
                false => None,
            },
            decoder: model.decoder()?,
            probe: model.probe()?,
        })
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
        views => format!(", {views} views side by side"),
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

/// One picture through all parts, how long each takes here, and whether that is fast enough for a camera with
/// `frame_period` between frames.
fn run_once(parts: &Parts, frame_period: Duration) -> Result<String> {
    let mut text = String::new();
    let (height, width) = parts.encoder.input_size();
    let picture = Tensor::full(0.5f32, (1, height, width, 3), &Device::Cpu)?;
    let (latent, encode) = timed(|| parts.encoder.encode(&picture)).context("encoding")?;
    line(&mut text, "encode a frame", encode)?;

    let mut next = latent.clone();
    let mut predict = None;
    match &parts.transition {
        None => writeln!(text, "no transition: nothing will be predicted")?,
        Some(WorldModel { transition, .. }) => {
            let context = latent.unsqueeze(0)?;
            let action = Tensor::zeros(
                (1, transition.config().action_dim),
                DType::F32,
                &Device::Cpu,
            )?;
            let sampler = &transition.config().sampler;
            let (predicted, time) =
                timed(|| Rollout::new(transition, sampler, &context, None, 0)?.next(&action))
                    .context("predicting")?;
            line(&mut text, "predict a frame", time)?;
            (next, predict) = (predicted, Some(time));
        }
    }
    let mut decode = None;
    match &parts.decoder {
        None => writeln!(text, "no decoder: there will be no pictures")?,
        Some(decoder) => {
            let (_, time) = timed(|| decoder.decode(&next)).context("decoding")?;
            line(&mut text, "decode a frame", time)?;
            decode = Some(time);
        }
    }
    match &parts.probe {
        None => writeln!(text, "no probe: there will be no success probabilities")?,
        Some(probe) => {
            let started = Instant::now();
            let instruction = probe
                .instruction(
                    probe
                        .vocabulary()
                        .and_then(|words| words.first())
                        .map_or(TASK, String::as_str),
                )
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
    let transition = parts.transition.as_ref();
    let times = Times {
        encode,
        predict,
        decode,
        frame_period,
        frame_skip: transition.map_or(1, |model| model.encoding.frame_skip()),
    };
    writeln!(text, "{times}")?;
    Ok(text)
}

/// What `run` gives, and how long it takes once everything that it touches is in memory.
fn timed<T, E>(run: impl Fn() -> Result<T, E>) -> Result<(T, Duration), E> {
    run()?;
    let started = Instant::now();
    let found = run()?;
    Ok((found, started.elapsed()))
}

fn line(text: &mut String, what: &str, time: Duration) -> std::fmt::Result {
    writeln!(text, "{what:<18}{:>10.1} ms", time.as_secs_f64() * 1e3)
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_default_runs() {
        let model = ModelFolder::open("tiny").unwrap();
        let parts = Parts::load(&model).unwrap();
        let text = run_once(&parts, Duration::from_secs(1)).unwrap();
        assert_eq!(text.lines().count(), 9, "{text}");
        for part in ["encoder: ", "predictor: ", "decoder: ", "for 1 Hz: "] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn a_rate_is_one_that_the_nodes_take() {
        assert_eq!(parse_rate("2.5"), Ok(2.5));
        for wrong in ["0", "-5", "1e9", "nan", "fast"] {
            assert!(parse_rate(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_folder_without_a_transition_is_encoder_and_decoder_only() {
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

        // Where the transition is there and damaged, that is an error.
        std::fs::write(folder.path().join("transition.safetensors"), "x").unwrap();
        assert!(Parts::load(&model).is_err());
    }
}
