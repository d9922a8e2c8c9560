//! One moment, as every node of the model sees it.

use std::{sync::Arc, time::Instant};

use candle_core::{Device, Tensor};
use wm_model::{
    LatentSpace,
    sampler::{Rollout, Sampler},
    transition::LoadedTransition,
};
use wm_motion::motion::StepAction;
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
    wm_msgs::Action,
};

use super::{CameraStep, Frame, Timing, Wait};

/// The observations and actions up to a frame, from which a prediction, a plan or an assessment starts.
#[derive(Clone, Debug)]
pub struct Moment {
    /// The history that it belongs to.
    pub epoch: u64,
    /// The epoch of the latents, as their publisher numbers it.
    pub source_epoch: u64,
    /// The observed frame.
    pub observed: Frame,
    /// Frames before it, one model step apart, oldest first.
    pub earlier: Vec<Frame>,
    /// The actions from each earlier frame to the next, in order.
    pub past: Vec<StepAction>,
    /// The frame of the actions' deltas, as the robot names it; empty if no action has arrived.
    pub base_frame: Arc<str>,
    /// How stamps are grouped into model steps.
    pub timing: Timing,
    /// Whether the camera had stopped by the newest frame, which may be later than the observed one.
    pub is_frozen: bool,
    /// The step of the camera's clock, if it and the clock of the actions do not agree.
    pub camera_step: Option<CameraStep>,
}

impl Moment {
    /// Context frames as (1, T, h, w, C).
    ///
    /// # Errors
    /// Where latents are not of the space.
    pub fn context(&self, space: &LatentSpace) -> Result<Tensor, candle_core::Error> {
        let frames = self.earlier.iter().chain([&self.observed]);
        let values: Vec<f32> = frames
            .flat_map(|frame| frame.values.iter().copied())
            .collect();
        let (height, width, channels) = space.shape();
        let shape = (1, self.earlier.len() + 1, height, width, channels);
        Tensor::from_vec(values, shape, &Device::Cpu)
    }

    /// The model actions between context frames as (T - 1, A); none for a single frame.
    ///
    /// # Errors
    /// Where they are not of one length.
    pub fn past_actions(&self) -> Result<Option<Tensor>, candle_core::Error> {
        stack(&self.past)
    }

    /// A rollout from here, with the noise of `seed`.
    ///
    /// # Errors
    /// Where the model does not take the context.
    pub fn rollout<'m>(
        &self,
        model: &'m LoadedTransition,
        space: &LatentSpace,
        sampler: &Sampler,
        seed: u64,
    ) -> wm_model::Result<Rollout<'m>> {
        let past = self.past_actions()?;
        Rollout::new(model, sampler, &self.context(space)?, past.as_ref(), seed)
    }

    /// The header of the moment `steps` model steps later.
    pub fn header_after(&self, steps: usize) -> Header {
        Header {
            stamp: Time::from_nanos(self.timing.step_at(self.observed.stamp_ns, steps)),
            frame_id: self.observed.frame_id.to_string(),
        }
    }

    /// The actions of a step that begins `steps` model steps later, one for each interval.
    pub fn messages(&self, steps: usize, action: &StepAction) -> Vec<Action> {
        let start_ns = self.timing.step_at(self.observed.stamp_ns, steps);
        let slots = self.timing.slots(start_ns);
        let messages = action
            .intervals
            .iter()
            .zip(slots)
            .map(|(interval, stamp_ns)| Action {
                header: Header {
                    stamp: Time::from_nanos(stamp_ns),
                    frame_id: self.base_frame.to_string(),
                },
                values: interval.values.clone(),
            });
        messages.collect()
    }

    /// One model step as a message has it.
    pub fn step_period(&self) -> Duration {
        Duration::from_nanos(self.timing.step_ns())
    }

    /// Checks that the observed frame is fresh at `now`, so that an arm may act on it.
    ///
    /// # Errors
    /// [`Wait::Frozen`] if the camera has stopped, [`Wait::CameraClock`] if its clock has stepped, [`Wait::Stale`] if the
    /// frame was received longer ago than `max_age`.
    pub fn expect_fresh(&self, now: Instant, max_age: std::time::Duration) -> Result<(), Wait> {
        if self.is_frozen {
            return Err(Wait::Frozen);
        }
        if let Some(step) = self.camera_step {
            return Err(Wait::CameraClock(step));
        }
        let age = now.saturating_duration_since(self.observed.reception.at);
        if age <= max_age {
            return Ok(());
        }
        Err(Wait::Stale {
            age_s: age.as_secs_f64(),
            max_s: max_age.as_secs_f64(),
        })
    }
}

/// Model actions as (n, A); none for none.
pub(crate) fn stack(steps: &[StepAction]) -> Result<Option<Tensor>, candle_core::Error> {
    let Some(first) = steps.first() else {
        return Ok(None);
    };
    let values: Vec<f32> = steps
        .iter()
        .flat_map(|step| step.model.values.iter().copied())
        .collect();
    let shape = (steps.len(), first.model.values.len());
    Tensor::from_vec(values, shape, &Device::Cpu).map(Some)
}
