//! Self-forcing: the student continues from its own predictions, and learns the correct continuation; see [`super`].

use anyhow::Result;
use candle_core::{D, DType, Tensor};
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use wm_dataset::ClipSource;
use wm_model::{
    sampler::Sampler,
    transition::{ActionAlignment, TemporalPattern, Transition},
};

use super::{Networks, consistency::pseudo_huber, recipe::SelfForcingRecipe};
use crate::transition::{Objective, normals};

/// A frame to predict from a history with the student's own predictions.
pub(super) struct OwnHistory {
    /// (B, t, h, w, C).
    frames: Tensor,
    /// (B, n, A), of the clip's frames.
    actions: Tensor,
    /// Noise of the prediction, true frame, and teacher's prediction: (B, 1, h, w, C).
    noise: Tensor,
    truth: Tensor,
    taught: Tensor,
}

impl OwnHistory {
    /// Rolls the student out over random clips, up to the second last frame.
    pub(super) fn draw(
        networks: &Networks<'_>,
        teacher: &Sampler,
        objective: &Objective,
        recipe: &SelfForcingRecipe,
        clips: &ClipSource<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self> {
        let (latents, actions) = objective.draw_clips(clips, rng)?;
        let past = objective.recipe.history;
        let last = past + rng.random_range(2..=recipe.frames) - 1;
        let mut frames = latents.narrow(1, 0, past)?.contiguous()?;
        let truth = latents.narrow(1, last, 1)?.contiguous()?;
        let student = networks.student;
        for _ in past..last {
            let noise = normals(truth.dims(), truth.device(), rng)?;
            let next = predict(
                student,
                &student.config().sampler,
                &frames,
                &actions,
                &noise,
            )?;
            frames = Tensor::cat(&[&frames, &next.detach()], 1)?;
        }
        let noise = normals(truth.dims(), truth.device(), rng)?;
        let taught = predict(networks.teacher, teacher, &frames, &actions, &noise)?;
        Ok(Self {
            frames,
            actions,
            noise,
            truth,
            taught,
        })
    }

    /// Squared distance of the student's prediction to the true frame, weighted by `real`, and its distance to the teacher's
    /// prediction, weighted by the rest.
    pub(super) fn loss(&self, student: &Transition, real: f64, huber: f64) -> Result<Tensor> {
        let sampler = &student.config().sampler;
        let predicted = predict(student, sampler, &self.frames, &self.actions, &self.noise)?;
        let from_truth = (&predicted - &self.truth)?.sqr()?.mean_all()?;
        let from_taught = pseudo_huber(&(predicted - &self.taught)?, huber)?;
        Ok(((from_truth * real)? + (from_taught * (1.0 - real))?)?)
    }
}

/// The frame (B, 1, h, w, C) after `frames` (B, t, h, w, C), integrated from `noise` as in the sampler; `actions`
/// (B, >= t + 1, A) belong to the frames.
pub(super) fn predict(
    model: &Transition,
    sampler: &Sampler,
    frames: &Tensor,
    actions: &Tensor,
    noise: &Tensor,
) -> Result<Tensor> {
    let config = model.config();
    let (b, t) = (frames.dim(0)?, frames.dim(1)?);
    let device = frames.device();
    let actions = match config.action_alignment {
        ActionAlignment::WithFrame => actions.narrow(1, 0, t + 1)?.contiguous()?,
        ActionAlignment::WithResult => {
            let first = Tensor::zeros((b, 1, actions.dim(D::Minus1)?), DType::F32, device)?;
            Tensor::cat(&[&first, &actions.narrow(1, 0, t)?], 1)?
        }
    };
    let previous = frames.narrow(1, t - 1, 1)?;
    let context = Tensor::full(sampler.context_tau as f32, (b, t), device)?;
    let pattern = TemporalPattern::causal(t + 1);
    let levels = sampler.levels();
    let mut x = noise.clone();
    for (from, to) in levels.iter().zip(levels.iter().skip(1)) {
        let tau = Tensor::full(*from as f32, (b, 1), device)?;
        let all = Tensor::cat(&[&context, &tau], D::Minus1)?;
        let frames = Tensor::cat(&[frames, &x], 1)?;
        let output = model.output(&frames, &all, &actions, &pattern, 1)?;
        let velocity = config
            .parametrisation
            .velocity(&output, &x, &tau, &previous)?;
        x = (x - (velocity * (from - to))?)?;
    }
    Ok(x)
}
