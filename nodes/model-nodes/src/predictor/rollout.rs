//! One rollout: from a request to predictions, one by one.

use std::sync::Arc;

use wm_model::{
    WorldModel,
    sampler::{Prepared, Rollout},
};
use wm_motion::motion::StepAction;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, Prediction},
};
use wm_wire::latent_message::{LatentDtype, encode_latent};

use super::{Fit, PredictorError, calibration::scaled};
use crate::history::{Frame, Moment, model_values};

/// The inputs of a rollout.
#[derive(Clone, Debug)]
pub struct RolloutRequest {
    /// Its start.
    pub moment: Moment,
    /// The actions assumed for each coming model step, and for one more.
    pub future: Vec<StepAction>,
    /// Model steps to predict.
    pub horizon: usize,
    /// Seed of the noise.
    pub seed: u64,
    /// Euler steps per predicted frame.
    pub integration_steps: usize,
    /// Type of the numbers in the messages.
    pub dtype: LatentDtype,
}

/// One predicted step.
#[derive(Clone, Debug)]
pub struct PredictedStep {
    /// The observation that the rollout started from.
    pub observed: Frame,
    /// The latent before it was calibrated, and rounded for the wire.
    pub values: Arc<[f32]>,
    /// The factor of its calibration; 1 without.
    pub factor: f64,
    /// Number of values of its action beyond the model's clips.
    pub clipped: usize,
    /// The message without `ready_stamp`, which the sender fills in.
    pub prediction: Prediction,
}

/// A rollout under way: an iterator over its steps. The context's keys and values are computed once, with the first step.
pub struct RunningRollout<'m> {
    model: &'m WorldModel,
    request: RolloutRequest,
    rollout: Rollout<'m>,
    actions: Vec<Action>,
    fits: Vec<Fit>,
    step: usize,
    has_failed: bool,
}

impl<'m> RunningRollout<'m> {
    /// Starts a rollout.
    ///
    /// # Errors
    /// Where the model does not take the context.
    pub fn new(model: &'m WorldModel, request: RolloutRequest) -> Result<Self, PredictorError> {
        let mut sampler = model.transition.config().sampler.clone();
        sampler.steps = request.integration_steps;
        let moment = &request.moment;
        let rollout = moment.rollout(&model.transition, &sampler, request.seed)?;
        Ok(Self {
            model,
            request,
            rollout,
            actions: Vec::new(),
            fits: Vec::new(),
            step: 0,
            has_failed: false,
        })
    }

    /// Takes over the computation from before the observation; see [`Rollout::take_over`].
    #[must_use]
    pub fn taking_over(mut self, prepared: Option<&Prepared>) -> Self {
        if let Some(prepared) = prepared {
            self.rollout.take_over(prepared);
        }
        self
    }

    /// Scales the motion of each step by the factor of its fit; see [`PredictorStep::fits`](super::PredictorStep::fits).
    #[must_use]
    pub fn calibrated(mut self, fits: Vec<Fit>) -> Self {
        self.fits = fits;
        self
    }

    fn advance(
        &mut self,
        action: &StepAction,
        next: &StepAction,
    ) -> Result<PredictedStep, PredictorError> {
        let (fed, own) = ([model_values(action)], [model_values(next)]);
        // One candidate has one latent.
        let values = self.rollout.predict(&fed, Some(&own))?.concat();
        let moment = &self.request.moment;
        self.actions.extend(moment.messages(self.step, action));
        let factor = self.fits.get(self.step).map_or(1.0, |fit| fit.factor);
        self.step += 1;

        let header = moment.header_after(self.step);
        let calibrated = match factor == 1.0 {
            true => None,
            false => Some(scaled(&moment.observed.values, &values, factor)),
        };
        let mut latent = encode_latent(
            calibrated.as_ref().unwrap_or(&values),
            &self.model.space,
            self.request.dtype,
            header.clone(),
        )?;
        latent.epoch = moment.source_epoch;
        let prediction = Prediction {
            header,
            observed_stamp: Time::from_nanos(moment.observed.stamp_ns),
            step: count(self.step),
            horizon: count(self.request.horizon),
            step_period: moment.step_period(),
            latent,
            actions: self.actions.clone(),
            epoch: moment.epoch,
            model: self.model.name.clone(),
            model_hash: self.model.hash.clone(),
            seed: self.request.seed,
            integration_steps: count(self.request.integration_steps),
            received_stamp: moment.observed.reception.stamp,
            ready_stamp: Time::default(),
        };
        Ok(PredictedStep {
            observed: moment.observed.clone(),
            values: values.into(),
            factor,
            clipped: action.model.clipped,
            prediction,
        })
    }
}

/// Ends after the last step, or after the first that fails.
impl Iterator for RunningRollout<'_> {
    type Item = Result<PredictedStep, PredictorError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed || self.step >= self.request.horizon {
            return None;
        }
        let action = self.request.future.get(self.step)?.clone();
        // After the last known action it goes on.
        let next = self
            .request
            .future
            .get(self.step + 1)
            .unwrap_or(&action)
            .clone();
        let step = self.advance(&action, &next);
        self.has_failed = step.is_err();
        Some(step)
    }
}

/// Counts of a message; horizons and step counts are bounded far below.
fn count(value: usize) -> u32 {
    // Horizons and Euler steps, far below 2^32.
    u32::try_from(value).unwrap_or(u32::MAX)
}
