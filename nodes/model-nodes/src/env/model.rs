//! The models of an env: encoder, predictor and decoder.

use std::sync::Arc;

use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_model::{
    Decoder, LatentSpace,
    image::to_rgb,
    sampler::{Given, Noise, Rollout, Sampler},
};
use wm_motion::actions::ActionError;
use wm_msgs::wm_msgs::Action;

use super::{EnvError, episode::Episode};
use wm_model::WorldModel;

use crate::encoder::EncoderStep;

/// A step to predict.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    pub episode: &'a Episode,
    /// Its model action.
    pub action: &'a [f32],
    /// The one after it.
    pub next: &'a [f32],
}

/// Encoder, transition model and decoder of one latent space.
pub struct EnvModel {
    encoder: EncoderStep,
    predictor: WorldModel,
    decoder: Box<dyn Decoder>,
    sampler: Sampler,
    /// Episodes that are computed together at most.
    batch: usize,
}

impl EnvModel {
    /// A world of these models, with `integration_steps` Euler steps per frame (0: the model's own number), that computes at
    /// most `batch` episodes together.
    pub fn new(
        encoder: EncoderStep,
        predictor: WorldModel,
        decoder: Box<dyn Decoder>,
        integration_steps: usize,
        batch: usize,
    ) -> Self {
        let mut sampler = predictor.transition.config().sampler.clone();
        if integration_steps > 0 {
            sampler.steps = integration_steps;
        }
        Self {
            encoder,
            predictor,
            decoder,
            sampler,
            batch: batch.max(1),
        }
    }

    /// The transition model and its description for messages.
    pub fn predictor(&self) -> &WorldModel {
        &self.predictor
    }

    /// Euler steps a frame.
    pub fn integration_steps(&self) -> usize {
        self.sampler.steps
    }

    /// Bytes of a raw picture's pixels.
    pub fn raw_bytes(&self) -> usize {
        let (height, width) = self.decoder.output_size();
        height * width * 3
    }

    fn space(&self) -> &LatentSpace {
        &self.predictor.space
    }

    /// Past frames that a prediction can use.
    pub(super) fn window(&self) -> usize {
        self.predictor
            .transition
            .config()
            .max_frames
            .saturating_sub(1)
            .max(1)
    }

    /// The latent of an image, row-major, channels last.
    ///
    /// # Errors
    /// Those of the encoder.
    pub fn see(&self, picture: &RgbImage) -> Result<Arc<[f32]>, EnvError> {
        Ok(self.encoder.encode_values(picture)?.into())
    }

    /// The picture of a latent.
    ///
    /// # Errors
    /// Those of the decoder.
    pub fn picture(&self, latent: &[f32]) -> Result<RgbImage, EnvError> {
        let (height, width, channels) = self.space().shape();
        let latent = Tensor::from_slice(latent, (1, height, width, channels), &Device::Cpu)?;
        Ok(to_rgb(&self.decoder.decode(&latent)?.squeeze(0)?)?)
    }

    /// The model action of a robot that stands still: no change, and states at their middle; a gripper is open.
    pub(super) fn standing_still(&self) -> Result<Vec<f32>, EnvError> {
        let encoding = &self.predictor.encoding;
        let dimensions = encoding.space().dimensions().iter();
        let still: Vec<f32> = dimensions
            .map(|dimension| match dimension.kind.is_gripper() {
                true => 1.0 / dimension.scale + dimension.offset,
                false => dimension.offset,
            })
            .collect();
        self.encode(&vec![still; encoding.frame_skip()])
    }

    /// The model action of the camera-rate actions of one step.
    pub(super) fn model_action(&self, actions: &[Action]) -> Result<Vec<f32>, EnvError> {
        let values: Vec<_> = actions.iter().map(|action| &action.values).collect();
        self.encode(&values)
    }

    fn encode<V: AsRef<[f32]>>(&self, intervals: &[V]) -> Result<Vec<f32>, EnvError> {
        let encoded = self.predictor.encoding.encode_step(intervals);
        Ok(encoded
            .map_err(|source: ActionError| crate::predictor::PredictorError::from(source))?
            .values)
    }

    /// The latent after each episode's model action, in their order. Episodes with histories of one length are computed
    /// together.
    pub(super) fn predict(&self, rows: &[Row<'_>]) -> Result<Vec<Arc<[f32]>>, EnvError> {
        let mut order: Vec<usize> = (0..rows.len()).collect();
        let length = |index: &usize| rows.get(*index).map_or(0, |row| row.episode.frames().len());
        order.sort_by_key(length);
        let mut predicted: Vec<(usize, Arc<[f32]>)> = Vec::with_capacity(rows.len());
        for alike in order.chunk_by(|a, b| length(a) == length(b)) {
            for indices in alike.chunks(self.batch) {
                let batch: Vec<_> = indices
                    .iter()
                    .filter_map(|index| rows.get(*index).copied())
                    .collect();
                predicted.extend(indices.iter().copied().zip(self.predict_alike(&batch)?));
            }
        }
        predicted.sort_by_key(|(index, _)| *index);
        Ok(predicted.into_iter().map(|(_, latent)| latent).collect())
    }

    /// As [`Self::predict`], for episodes with histories of one length.
    fn predict_alike(&self, rows: &[Row<'_>]) -> Result<Vec<Arc<[f32]>>, EnvError> {
        let (height, width, channels) = self.space().shape();
        let action_dim = self.predictor.encoding.action_dim();
        let (batch, frames) = (
            rows.len(),
            rows.first().map_or(0, |row| row.episode.frames().len()),
        );
        let context: Vec<f32> = rows
            .iter()
            .flat_map(|row| row.episode.frames().flat_map(|frame| frame.iter().copied()))
            .collect();
        let context = Tensor::from_vec(
            context,
            (batch, frames, height, width, channels),
            &Device::Cpu,
        )?;
        let past: Vec<f32> = rows
            .iter()
            .flat_map(|row| row.episode.actions().flatten().copied())
            .collect();
        let past = (frames > 1)
            .then(|| Tensor::from_vec(past, (batch, frames - 1, action_dim), &Device::Cpu))
            .transpose()?;
        let stack = |of: fn(&Row<'_>) -> Vec<f32>| {
            let values: Vec<f32> = rows.iter().flat_map(of).collect();
            Tensor::from_vec(values, (batch, action_dim), &Device::Cpu)
        };
        let action = stack(|row| row.action.to_vec())?;
        let next = stack(|row| row.next.to_vec())?;
        let noise: Vec<Noise> = rows
            .iter()
            .map(|row| Noise {
                seed: row.episode.seed(),
                first_step: row.episode.steps(),
            })
            .collect();
        let model = &self.predictor.transition;
        let mut rollout = Rollout::batch(model, &self.sampler, &context, past.as_ref(), &noise)?;
        let given = Given {
            own_action: Some(&next),
            ..Given::default()
        };
        let latents = rollout.next_given(&action, given)?;
        let latents = latents.flatten_from(1)?.to_vec2::<f32>()?;
        Ok(latents.into_iter().map(Into::into).collect())
    }
}
