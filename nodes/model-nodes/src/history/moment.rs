//! One moment, as every node of the model sees it.

use std::{sync::Arc, time::Instant};

use wm_model::{
    sampler::{Noise, Observed, Rollout, Sampler},
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
    /// Latents of the context frames, oldest first.
    pub fn context(&self) -> Vec<&[f32]> {
        let frames = self.earlier.iter().chain([&self.observed]);
        frames.map(|frame| &*frame.values).collect()
    }

    /// A rollout from here, with the noise of `seed`.
    ///
    /// # Errors
    /// If the context does not fit the model.
    pub fn rollout<'m>(
        &self,
        model: &'m LoadedTransition,
        sampler: &Sampler,
        seed: u64,
    ) -> wm_model::Result<Rollout<'m>> {
        let observed = Observed {
            frames: self.context(),
            actions: self.past.iter().map(model_values).collect(),
            noise: Noise {
                seed,
                first_step: 0,
            },
        };
        Rollout::of_values(model, sampler, &[observed])
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

/// The values that the model takes for an action.
pub(crate) fn model_values(step: &StepAction) -> &[f32] {
    &step.model.values
}
