//! A model, run once.

use crate::{DoctorError, Times};
use candle_core::{DType, Device, Tensor};
use std::time::{Duration, Instant};
use wm_model::sampler::Rollout;
use wm_model::{Decoder, Encoder, WorldModel};
use wm_zoo::ModelFolder;
use wm_zoo::success_probe::SuccessClassifier;

/// An instruction to try a success probe with that reads any text.
const TASK: &str = "put the cup on the plate";

/// What of a model there is, loaded.
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

/// How long each part takes here, once everything that it touches is in memory.
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    /// A picture to a latent.
    pub encode: Duration,
    /// One predicted frame; none where there is no transition model.
    pub predict: Option<Duration>,
    /// A latent to a picture; none where there is no decoder.
    pub decode: Option<Duration>,
    /// What the success probe takes, if there is one.
    pub judge: Option<Judging>,
    /// Camera frames of a model step.
    pub frame_skip: usize,
}

/// How long a success probe takes.
#[derive(Clone, Copy, Debug)]
pub struct Judging {
    /// To read an instruction.
    pub reading: Duration,
    /// To judge an episode of two frames.
    pub judging: Duration,
    /// Frames of the longest episode that it takes.
    pub max_frames: usize,
}

impl Trial {
    /// The same, for a camera with `frame_period` between frames.
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
    /// Loads them as the nodes do.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
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

    /// One grey picture through all of them.
    ///
    /// # Errors
    /// A part computes nothing, by name.
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

fn judging(probe: &SuccessClassifier, episode: &Tensor) -> wm_zoo::Result<Judging> {
    let known = probe.vocabulary().and_then(|words| words.first());
    let started = Instant::now();
    let instruction = probe.instruction(known.map_or(TASK, String::as_str))?;
    let reading = started.elapsed();
    let started = Instant::now();
    probe.probability(episode, &instruction)?;
    Ok(Judging {
        reading,
        judging: started.elapsed(),
        max_frames: probe.max_frames(),
    })
}

/// What `run` gives, and how long it takes once everything that it touches is in memory.
fn timed<T, E>(run: impl Fn() -> Result<T, E>) -> Result<(T, Duration), E> {
    run()?;
    let started = Instant::now();
    let found = run()?;
    Ok((found, started.elapsed()))
}
