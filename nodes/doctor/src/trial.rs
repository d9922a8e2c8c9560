//! Runs a model once.

use crate::{DoctorError, Times};
use image::{Rgb, RgbImage};
use std::time::{Duration, Instant};
use wm_model::sampler::{Noise, Observed, Rollout};
use wm_model::{Decoder, Encoder, LatentSpace, WorldModel};
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
        let failed = DoctorError::of::<wm_model::Error>;
        let (height, width) = self.encoder.input_size();
        // Too large for an image is too large for the encoder: it fails.
        let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
        let picture = RgbImage::from_pixel(side(width), side(height), Rgb([128; 3]));
        let image = self.encoder.prepare(&picture);
        let image = image.map_err(failed("a picture"))?;
        let (latent, encode) = timed(|| self.encoder.values(&image)).map_err(failed("encoding"))?;

        let mut next = latent.clone();
        let mut predict = None;
        if let Some(WorldModel { transition, .. }) = &self.transition {
            let config = transition.config();
            let action = vec![0.0; config.action_dim];
            let observed = [Observed {
                frames: vec![&latent],
                actions: Vec::new(),
                noise: Noise {
                    seed: 0,
                    first_step: 0,
                },
            }];
            let (predicted, time) = timed(|| {
                Rollout::of_values(transition, &config.sampler, &observed)?
                    .predict(&[&action], None)
            })
            .map_err(failed("predicting"))?;
            (next, predict) = (predicted.concat(), Some(time));
        }
        let decode = match &self.decoder {
            None => None,
            Some(decoder) => {
                let (_, time) = timed(|| decoder.picture(&next)).map_err(failed("decoding"))?;
                Some(time)
            }
        };
        let judge = match &self.probe {
            None => None,
            Some(probe) => {
                let judging = judging(probe, self.encoder.space(), &[&latent, &next]);
                Some(judging.map_err(DoctorError::of("the success probe"))?)
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

fn judging(
    probe: &SuccessClassifier,
    space: &LatentSpace,
    frames: &[&[f32]],
) -> wm_zoo::Result<ProbeTimes> {
    let episode = space.stack(frames)?;
    let known = probe.vocabulary().and_then(|words| words.first());
    let started = Instant::now();
    let instruction = probe.instruction(known.map_or(TASK, String::as_str))?;
    let reading = started.elapsed();
    let started = Instant::now();
    probe.probability(&episode, &instruction)?;
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
