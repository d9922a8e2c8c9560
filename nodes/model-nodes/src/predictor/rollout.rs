//! One rollout: from a request to predictions, one by one.

use std::sync::Arc;

use candle_core::{Device, Tensor};
use wm_model::{
    LatentSpace, actions::ActionEncoding, sampler::Rollout, transition::PackedTransition,
};
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
    wm_msgs::{Action, Prediction},
};

use super::PredictorError;
use crate::timeline::{Context, Frame, PhysicalAction, Timing};
use wm_wire::latent_message::{LatentDtype, encode_latent};

/// The model that predicts, and what its messages say of it.
#[derive(Clone, Debug)]
pub struct PredictorModel {
    /// The transition model.
    pub transition: PackedTransition,
    /// Its name.
    pub name: String,
    /// Lower-case hex SHA-256 of its weights and configuration.
    pub hash: String,
    /// The space of its latents.
    pub space: LatentSpace,
    /// How physical actions become its actions.
    pub encoding: ActionEncoding,
}

/// All that a rollout is computed from.
#[derive(Clone, Debug)]
pub struct RolloutRequest {
    /// The timeline's epoch: a rollout of an earlier one is of the time before a flush.
    pub epoch: u64,
    /// Context frames and the actions between them; the last frame is the observation.
    pub context: Context,
    /// The actions assumed for each coming model step.
    pub future: Vec<Vec<PhysicalAction>>,
    /// When the observation's latent was received (node clock).
    pub received: Time,
    /// Seed of the noise.
    pub seed: u64,
    /// Euler steps a predicted frame.
    pub integration_steps: usize,
    /// Type of the numbers in the messages.
    pub dtype: LatentDtype,
    /// How stamps make model steps.
    pub timing: Timing,
}

/// One predicted step.
#[derive(Clone, Debug)]
pub struct PredictedStep {
    /// The epoch of the request.
    pub epoch: u64,
    /// The observation that the rollout started from.
    pub observed: Frame,
    /// The latent before it was rounded for the wire.
    pub values: Arc<[f32]>,
    /// The message, but for `ready_stamp`, which is the sender's to fill.
    pub prediction: Prediction,
}

/// A rollout under way: an iterator over its steps. The context's keys and values are computed once, with the first step.
pub struct RunningRollout<'m> {
    model: &'m PredictorModel,
    request: RolloutRequest,
    rollout: Rollout<'m>,
    observed: Frame,
    actions: Vec<Action>,
    step: usize,
    has_failed: bool,
}

impl<'m> RunningRollout<'m> {
    /// Starts a rollout.
    ///
    /// # Errors
    /// Where actions cannot be encoded or the model does not take the context.
    pub fn new(model: &'m PredictorModel, request: RolloutRequest) -> Result<Self, PredictorError> {
        let observed =
            request
                .context
                .frames
                .last()
                .cloned()
                .ok_or_else(|| wm_model::Error::Shape {
                    what: "the context",
                    expected: "at least one frame".into(),
                    found: vec![0],
                })?;
        let mut sampler = model.transition.config().sampler.clone();
        sampler.steps = request.integration_steps;
        let context = context_tensor(&request.context, &model.space)?;
        let past = past_actions(&request.context, &model.encoding)?;
        let rollout = Rollout::new(
            &model.transition,
            &sampler,
            &context,
            past.as_ref(),
            request.seed,
        )?;
        Ok(Self {
            model,
            request,
            rollout,
            observed,
            actions: Vec::new(),
            step: 0,
            has_failed: false,
        })
    }

    fn advance(&mut self, actions: &[PhysicalAction]) -> Result<PredictedStep, PredictorError> {
        let encoded = self.model.encoding.encode_step(actions)?;
        let action = Tensor::from_vec(encoded, (1, self.model.encoding.action_dim), &Device::Cpu)?;
        let values = self
            .rollout
            .next(&action)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        self.actions
            .extend(actions.iter().map(PhysicalAction::to_message));
        self.step += 1;

        let step_ns = self.request.timing.step_ns();
        // Horizons are a handful of steps.
        let stamp_ns = self.observed.stamp_ns + step_ns * self.step as i64;
        let header = Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: self.observed.frame_id.to_string(),
        };
        let latent = encode_latent(
            &values,
            &self.model.space,
            self.request.dtype,
            header.clone(),
        )?;
        let prediction = Prediction {
            header,
            observed_stamp: Time::from_nanos(self.observed.stamp_ns),
            step: count(self.step),
            horizon: count(self.request.future.len()),
            step_period: Duration::from_nanos(step_ns),
            latent,
            actions: self.actions.clone(),
            model: self.model.name.clone(),
            model_hash: self.model.hash.clone(),
            seed: self.request.seed,
            integration_steps: count(self.request.integration_steps),
            received_stamp: self.request.received,
            ready_stamp: Time::default(),
        };
        Ok(PredictedStep {
            epoch: self.request.epoch,
            observed: self.observed.clone(),
            values: values.into(),
            prediction,
        })
    }
}

/// Ends after the last step, or after the first that fails.
impl Iterator for RunningRollout<'_> {
    type Item = Result<PredictedStep, PredictorError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let actions = self.request.future.get(self.step)?.clone();
        let step = self.advance(&actions);
        self.has_failed = step.is_err();
        Some(step)
    }
}

/// Context frames as (1, T, h, w, C).
pub(crate) fn context_tensor(
    context: &Context,
    space: &LatentSpace,
) -> Result<Tensor, candle_core::Error> {
    let values: Vec<f32> = context
        .frames
        .iter()
        .flat_map(|frame| frame.values.iter().copied())
        .collect();
    let shape = (
        1,
        context.frames.len(),
        space.height,
        space.width,
        space.channels,
    );
    Tensor::from_vec(values, shape, &Device::Cpu)
}

/// The model actions between context frames as (T - 1, A); none for a single frame.
pub(crate) fn past_actions(
    context: &Context,
    encoding: &ActionEncoding,
) -> Result<Option<Tensor>, PredictorError> {
    if context.actions.is_empty() {
        return Ok(None);
    }
    let mut values = Vec::with_capacity(context.actions.len() * encoding.action_dim);
    for step in &context.actions {
        values.extend(encoding.encode_step(step)?);
    }
    Ok(Some(Tensor::from_vec(
        values,
        (context.actions.len(), encoding.action_dim),
        &Device::Cpu,
    )?))
}

/// Counts of a message; horizons and step counts are bounded far below.
fn count(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}
