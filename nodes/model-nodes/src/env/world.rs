//! The models of an env: what is seen, what comes next, what that looks like.

use std::sync::Arc;

use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_model::{
    Decoder, LatentSpace,
    actions::{GRIPPER, PHYSICAL_DIM},
    image::to_rgb,
    sampler::{Noise, Rollout, Sampler},
};

use super::{EnvError, episode::Episode};
use crate::{encoder::EncoderStep, predictor::PredictorModel};

/// Encoder, transition model and decoder of one latent space.
pub struct World {
    encoder: EncoderStep,
    predictor: PredictorModel,
    decoder: Box<dyn Decoder>,
    sampler: Sampler,
    /// Episodes that are computed together at most.
    batch: usize,
}

impl World {
    /// A world of these models, with `integration_steps` Euler steps a frame (0: what the model was trained for), that
    /// computes at most `batch` episodes together.
    pub fn new(
        encoder: EncoderStep,
        predictor: PredictorModel,
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

    /// The transition model and what messages say of it.
    pub fn predictor(&self) -> &PredictorModel {
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

    /// What a latent looks like.
    ///
    /// # Errors
    /// Those of the decoder.
    pub fn picture(&self, latent: &[f32]) -> Result<RgbImage, EnvError> {
        let (height, width, channels) = self.space().shape();
        let latent = Tensor::from_slice(latent, (1, height, width, channels), &Device::Cpu)?;
        Ok(to_rgb(&self.decoder.decode(&latent)?.squeeze(0)?)?)
    }

    /// The model action of a robot that stands still with an open gripper.
    pub(super) fn standing_still(&self) -> Result<Vec<f32>, EnvError> {
        let mut still = [0.0_f32; PHYSICAL_DIM];
        if let Some(gripper) = still.get_mut(GRIPPER) {
            *gripper = 1.0;
        }
        self.model_action(&vec![still; self.predictor.encoding.frame_skip])
    }

    /// The model action of the camera-rate actions of one step.
    pub(super) fn model_action(
        &self,
        actions: &[[f32; PHYSICAL_DIM]],
    ) -> Result<Vec<f32>, EnvError> {
        let encoded = self.predictor.encoding.encode_step(actions);
        Ok(encoded.map_err(crate::predictor::PredictorError::from)?)
    }

    /// The latents to which each episode's model action leads, in their order. Episodes whose histories are of one
    /// length are computed together.
    pub(super) fn predict(&self, rows: &[(&Episode, &[f32])]) -> Result<Vec<Arc<[f32]>>, EnvError> {
        let mut order: Vec<usize> = (0..rows.len()).collect();
        let length = |index: &usize| {
            rows.get(*index)
                .map_or(0, |(episode, _)| episode.frames().len())
        };
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

    /// As [`Self::predict`], of episodes whose histories are of one length.
    fn predict_alike(&self, rows: &[(&Episode, &[f32])]) -> Result<Vec<Arc<[f32]>>, EnvError> {
        let (height, width, channels) = self.space().shape();
        let action_dim = self.predictor.encoding.action_dim;
        let (batch, frames) = (
            rows.len(),
            rows.first()
                .map_or(0, |(episode, _)| episode.frames().len()),
        );
        let context: Vec<f32> = rows
            .iter()
            .flat_map(|(episode, _)| episode.frames().flat_map(|frame| frame.iter().copied()))
            .collect();
        let context = Tensor::from_vec(
            context,
            (batch, frames, height, width, channels),
            &Device::Cpu,
        )?;
        let past: Vec<f32> = rows
            .iter()
            .flat_map(|(episode, _)| episode.actions().flatten().copied())
            .collect();
        let past = (frames > 1)
            .then(|| Tensor::from_vec(past, (batch, frames - 1, action_dim), &Device::Cpu))
            .transpose()?;
        let action: Vec<f32> = rows
            .iter()
            .flat_map(|(_, action)| action.iter().copied())
            .collect();
        let action = Tensor::from_vec(action, (batch, action_dim), &Device::Cpu)?;
        let noise: Vec<Noise> = rows
            .iter()
            .map(|(episode, _)| Noise {
                seed: episode.seed(),
                first_step: episode.steps(),
            })
            .collect();
        let model = &self.predictor.transition;
        let mut rollout = Rollout::batch(model, &self.sampler, &context, past.as_ref(), &noise)?;
        let latents = rollout.next(&action)?.flatten_from(1)?.to_vec2::<f32>()?;
        Ok(latents.into_iter().map(Into::into).collect())
    }
}
