//! The frames and actions that a model receives: the context up to a frame, and the steps after it.

use std::sync::Arc;

use wm_motion::{actions::ActionError, motion::StepAction};

use super::{Frame, History, Moment, Wait};

impl History {
    /// The moment of the newest frame.
    ///
    /// # Errors
    /// [`Wait`] says what is missing.
    pub fn moment(&self) -> Result<Moment, Wait> {
        self.moment_of(self.frames.newest().ok_or(Wait::NoFrame)?)
    }

    /// The newest frame that has a whole context; if none has, the newest one. A slow encoder's contexts come frame by
    /// frame: until the next one is whole, this is the frame of the last one.
    pub fn latest(&self) -> Option<&Frame> {
        let mut frames = self.frames.newest_first();
        let whole = frames.find(|frame| self.context(frame.stamp_ns).is_ok());
        whole.or(self.frames.newest())
    }

    /// The moment of that frame.
    ///
    /// # Errors
    /// [`Wait`] says what is missing.
    pub fn latest_moment(&self) -> Result<Moment, Wait> {
        self.moment_of(self.latest().ok_or(Wait::NoFrame)?)
    }

    /// Whether the newest frame lacks a context, but one was whole not long ago: with a slow encoder, the frames that
    /// follow will make the next one whole.
    pub fn is_between_contexts(&self) -> bool {
        self.rhythm.is_between(self.settings.context_frames)
    }

    fn moment_of(&self, observed: &Frame) -> Result<Moment, Wait> {
        let frames = self.context(observed.stamp_ns)?;
        let between = frames.iter().zip(frames.iter().skip(1));
        let past = between.map(|(from, to)| self.step(from.stamp_ns, to.stamp_ns));
        let past = past.collect::<Result<Vec<_>, _>>()?;
        let earlier = frames.split_last().map_or(&[][..], |(_, earlier)| earlier);
        Ok(Moment {
            epoch: self.epoch,
            source_epoch: self.source_epoch,
            observed: observed.clone(),
            earlier: earlier.iter().map(|frame| (*frame).clone()).collect(),
            past,
            base_frame: Arc::clone(&self.base_frame),
            timing: self.timing(),
            is_frozen: self.is_frozen(),
            camera_step: self.camera_step(),
        })
    }

    /// The frames of a context that ends with the frame of `stamp_ns`, oldest first.
    pub(super) fn context(&self, stamp_ns: i64) -> Result<Vec<&Frame>, Wait> {
        let timing = self.timing();
        let need = self.settings.context_frames.max(1);
        let mut frames = Vec::with_capacity(need);
        for back in 0..need {
            let wanted_ns = stamp_ns - timing.step_at(0, back);
            match self.frames.near(wanted_ns, timing.tolerance_ns) {
                Some(frame) => frames.push(frame),
                None => {
                    return Err(if let Some(slow) = self.slow_camera() {
                        slow
                    } else if self.frames.reach_back_to(wanted_ns) {
                        Wait::Gap {
                            missing_ns: wanted_ns,
                        }
                    } else {
                        let have = frames.len();
                        Wait::Context { have, need }
                    });
                }
            }
        }
        frames.reverse();
        Ok(frames)
    }

    /// The actions of the model steps after the newest frame: taken or announced ones, then the last action, held.
    ///
    /// # Errors
    /// [`Wait`] says what is missing.
    pub fn future(&self, steps: usize) -> Result<Vec<StepAction>, Wait> {
        let start_ns = self.frames.newest().ok_or(Wait::NoFrame)?.stamp_ns;
        self.future_from(start_ns, steps)
    }

    /// The same after the frame of `start_ns`.
    ///
    /// # Errors
    /// [`Wait`] says what is missing.
    pub fn future_from(&self, start_ns: i64, steps: usize) -> Result<Vec<StepAction>, Wait> {
        let timing = self.timing();
        let begin = |step| timing.step_at(start_ns, step);
        (0..steps)
            .map(|step| self.step(begin(step), begin(step + 1)))
            .collect()
    }

    pub(super) fn step(&self, from_ns: i64, to_ns: i64) -> Result<StepAction, Wait> {
        let step = self.motion.step(&self.encoding, from_ns, to_ns);
        // Every action was checked when it came: only a missing one is an error here.
        step.map_err(|error| Wait::NoAction {
            needed_ns: match error {
                ActionError::Unknown { at_ns } => at_ns,
                _ => from_ns,
            },
        })
    }

    pub(super) fn slow_camera(&self) -> Option<Wait> {
        let timing = self.timing();
        let camera_ns = self.frames.period_ns()?;
        let needed_ns = timing.frame_period_ns;
        (camera_ns > needed_ns + needed_ns / 2).then(|| {
            let seconds = |ns: i64| ns as f64 / 1e9;
            Wait::SlowCamera {
                camera_s: seconds(camera_ns),
                frame_s: seconds(needed_ns),
                step_s: seconds(camera_ns) * timing.frame_skip as f64,
            }
        })
    }
}
