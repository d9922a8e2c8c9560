//! Runs a model once.

use crate::{DoctorError, Times};
use candle_core::{DType, Device, Tensor};
use std::time::{Duration, Instant};
use wm_model::sampler::Rollout;
use wm_model::{Decoder, Encoder, WorldModel};
use wm_zoo::ModelFolder;
use wm_zoo::success_probe::SuccessClassifier;

/// An instruction for success probes that read any text.
const TASK: &str = "put the cup on the plate";

/// The loaded parts of a model.
pub struct Parts {
    /// Pictures to latents.
    pub encoder: Box<dyn Encoder>,
    /// Latents and actions to the next latents.
    pub transition: Option<WorldModel>,
    /// Latents to pictures.
    pub decoder: Option<Box<dyn Decoder>>,
    /// Latents and an instruction to the probability of success.
    pub probe: Option<SuccessClassifier>,
}

/// Durations of each part after warm-up.
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    /// One picture.
    pub encode: Duration,
    /// One predicted frame; `None` without a transition model.
    pub predict: Option<Duration>,
    /// One latent; `None` without a decoder.
    pub decode: Option<Duration>,
    /// `None` without a success probe.
    pub judge: Option<ProbeTimes>,
    /// Camera frames per model step.
    pub frame_skip: usize,
}

/// Durations of a success probe.
#[derive(Clone, Copy, Debug)]
pub struct ProbeTimes {
    /// Reading an instruction.
    pub reading: Duration,
    /// ProbeTimes an episode of two frames.
    pub judging: Duration,
    /// The most frames of an episode.
    pub max_frames: usize,
}

impl Trial {
    /// The verdict for a camera with `frame_period` between frames.
    #[must_use]
    pub fn at(&self, frame_period: Duration) -> Times {
        Times {
            encode: self.encode,
            predict: self.predict,
            decode: self.decode,
            frame_period,
            frame_skip: self.frame_skip,
        }
    }
}

impl Parts {
    /// Loads the parts as the nodes do.
    ///
    /// # Errors
    /// Names the missing or invalid weights.
    pub fn load(model: &ModelFolder) -> Result<Self, DoctorError> {
        let failed = DoctorError::of::<wm_zoo::Error>;
        Ok(Self {
            encoder: model.encoder().map_err(failed("the encoder"))?,
            transition: match model.has_transition() {
                true => Some(
                    model
                        .world_model()
                        .map_err(failed("the transition model"))?,
                ),
                false => None,
            },
            decoder: model.decoder().map_err(failed("the decoder"))?,
            probe: model.probe().map_err(failed("the success probe"))?,
        })
    }

    /// Runs one grey picture through all parts.
    ///
    /// # Errors
    /// Names the part that fails.
    pub fn try_out(&self) -> Result<Trial, DoctorError> {
        let encoding = DoctorError::of::<wm_model::Error>;
        let tensor = DoctorError::of::<candle_core::Error>;
        let (height, width) = self.encoder.input_size();
        let picture = Tensor::full(0.5f32, (1, height, width, 3), &Device::Cpu)
            .map_err(tensor("a picture"))?;
        let (latent, encode) =
            timed(|| self.encoder.encode(&picture)).map_err(encoding("encoding"))?;

        let mut next = latent.clone();
        let mut predict = None;
        if let Some(WorldModel { transition, .. }) = &self.transition {
            let config = transition.config();
            let context = latent.unsqueeze(0).map_err(tensor("a context"))?;
            let action = Tensor::zeros((1, config.action_dim), DType::F32, &Device::Cpu)
                .map_err(tensor("an action"))?;
            let (predicted, time) = timed(|| {
                Rollout::new(transition, &config.sampler, &context, None, 0)?.next(&action)
            })
            .map_err(encoding("predicting"))?;
            (next, predict) = (predicted, Some(time));
        }
        let decode = match &self.decoder {
            None => None,
            Some(decoder) => {
                let (_, time) = timed(|| decoder.decode(&next)).map_err(encoding("decoding"))?;
                Some(time)
            }
        };
        let judge = match &self.probe {
            None => None,
            Some(probe) => {
                let episode = Tensor::cat(&[&latent, &next], 0).map_err(tensor("an episode"))?;
                Some(judging(probe, &episode).map_err(DoctorError::of("the success probe"))?)
            }
        };
        let transition = self.transition.as_ref();
        Ok(Trial {
            encode,
            predict,
            decode,
            judge,
            frame_skip: transition.map_or(1, |model| model.encoding.frame_skip()),
        })
    }
}

fn judging(probe: &SuccessClassifier, episode: &Tensor) -> wm_zoo::Result<ProbeTimes> {
    let known = probe.vocabulary().and_then(|words| words.first());
    let started = Instant::now();
    let instruction = probe.instruction(known.map_or(TASK, String::as_str))?;
    let reading = started.elapsed();
    let started = Instant::now();
    probe.probability(episode, &instruction)?;
    Ok(ProbeTimes {
        reading,
        judging: started.elapsed(),
        max_frames: probe.max_frames(),
    })
}

/// The result of `run`, and its duration after warm-up.
fn timed<T, E>(run: impl Fn() -> Result<T, E>) -> Result<(T, Duration), E> {
    run()?;
    let started = Instant::now();
    let found = run()?;
    Ok((found, started.elapsed()))
}
