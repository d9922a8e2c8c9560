//! The models of an env: encoder, predictor and decoder.

use std::sync::Arc;

use image::RgbImage;
use wm_model::{
    Decoder,
    sampler::{Noise, Observed, Rollout, Sampler},
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
        Ok(self.decoder.picture(latent)?)
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
        let observed: Vec<Observed<'_>> = rows
            .iter()
            .map(|row| Observed {
                frames: row.episode.frames().map(|frame| &**frame).collect(),
                actions: row.episode.actions().map(Vec::as_slice).collect(),
                noise: Noise {
                    seed: row.episode.seed(),
                    first_step: row.episode.steps(),
                },
            })
            .collect();
        let actions: Vec<&[f32]> = rows.iter().map(|row| row.action).collect();
        let next: Vec<&[f32]> = rows.iter().map(|row| row.next).collect();
        let model = &self.predictor.transition;
        let mut rollout = Rollout::of_values(model, &self.sampler, &observed)?;
        let latents = rollout.predict(&actions, Some(&next))?;
        Ok(latents.into_iter().map(Into::into).collect())
    }
}
