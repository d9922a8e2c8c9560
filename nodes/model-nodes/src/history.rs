//! Observations and actions, aligned in time: the view of the present that predictor, planner, evaluator and env share.
//!
//! Latents, actions and chunks each carry a stamp; the transition model counts in model steps of several camera frames.
//! A [`History`] keeps the last few of each. From them it makes a [`Moment`] (the context of the newest frame) and the
//! actions of the steps after it ([`History::future`]), by stamps alone. It uses no clock and no topic: the same
//! messages give the same moments.
//!
//! A history belongs to one camera, one latent space and one *epoch*. A new epoch begins, and all frames are dropped, when
//! time jumps (a bag loops, a simulation restarts) or on request. A jump takes two frames in a row with such stamps. A gap
//! is no jump if as much time has passed: the camera was away, or the encoder is slow.

mod ahead;
mod arrival;
mod builder;
mod camera_clock;
mod context;
mod error;
mod frames;
mod held_back;
mod moment;
mod note;
mod rhythm;
mod stamp;
mod timing;
mod wait;

use std::{sync::Arc, time::Duration};

use wm_model::LatentSpace;
use wm_motion::{
    actions::ActionEncoding,
    motion::{Chunk, Motion, MotionSettings, Pace},
};
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk, Latent},
};
use wm_wire::latent_message::decode_latent;

pub use crate::{camera::WrongCamera, reception::Reception};
pub use ahead::Ahead;
pub use arrival::{Arrival, LateChunk};
pub use builder::HistoryBuilder;
pub use camera_clock::CameraStep;
pub use error::HistoryError;
pub use frames::{Frame, Observation};
pub use moment::Moment;
pub(crate) use moment::model_values;
pub(crate) use note::note;
pub use stamp::seconds;
pub(crate) use stamp::{period_of, stamp_of_frame, stamp_of_other};
pub use timing::Timing;
pub use wait::Wait;
pub use wm_motion::motion::{ChunkMerging, MAX_CHUNK};

use crate::camera::{Admission, Camera, Source};
use camera_clock::CameraClock;
use frames::Frames;
use held_back::HeldBack;
use rhythm::Rhythm;
use stamp::{ANNOUNCED_NS, seconds_of, stamp_of};
use wm_wire::stamp::AHEAD_NS;

/// A policy whose chunk differs from the frames by this much has another clock \[ns\]. A policy may answer before the frame
/// has passed the encoder, and may be slow.
const FAR_AHEAD_NS: i64 = 60_000_000_000;
/// The counter on `/diagnostics` of plans and evaluations that are dropped because the camera has stopped.
pub(crate) const FROZEN_CAMERA: &str = "frozen_camera";
/// A camera that is silent for this many frame periods, and at least a second, may be replaced by another.
const SILENT_FRAMES: u32 = 5;
/// How long actions are kept until the delay of the frames is known \[ns\].
const KEPT_AT_FIRST_NS: i64 = 60_000_000_000;
/// Actions are kept for this many times the age at which frames arrive: a slow encoder's contexts are that far apart.
const KEPT_AGES: i64 = 3;

/// Settings of a history.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HistorySettings {
    /// How stamps are grouped into model steps.
    pub timing: Timing,
    /// Frames of a context, one model step apart; at least 1.
    pub context_frames: usize,
    /// How overlapping chunks join.
    pub merging: ChunkMerging,
}

/// The last frames of one camera, and the robot's actions.
#[derive(Clone, Debug)]
pub struct History {
    settings: HistorySettings,
    space: LatentSpace,
    encoding: ActionEncoding,
    frames: Frames,
    motion: Motion,
    camera: Option<Camera>,
    camera_clock: CameraClock,
    /// Of the latents' publisher.
    source_epoch: u64,
    held_back: HeldBack,
    base_frame: Arc<str>,
    /// Which frames start a prediction.
    pace: Pace,
    late_chunk: Option<LateChunk>,
    rhythm: Rhythm,
    /// Greatest delay of a frame behind the newest action \[ns\].
    latest_ns: i64,
    epoch: u64,
}

impl History {
    /// An empty history of latents of `space` and actions as `encoding` takes them, begun at `begin` by the node's
    /// clock.
    pub fn new(
        settings: HistorySettings,
        space: LatentSpace,
        encoding: ActionEncoding,
        begin: Time,
    ) -> Self {
        let timing = settings.timing;
        let span_ns = timing.step_at(0, settings.context_frames.max(1));
        let motion = MotionSettings {
            keep_ns: KEPT_AT_FIRST_NS,
            ..MotionSettings::of_period(timing.frame_period_ns)
        };
        Self {
            space,
            encoding,
            frames: Frames::new(span_ns, settings.context_frames),
            motion: Motion::new(motion).with_merging(settings.merging),
            camera: None,
            camera_clock: CameraClock::default(),
            source_epoch: 0,
            held_back: HeldBack::default(),
            base_frame: "".into(),
            pace: Pace::new(timing.frame_period_ns, timing.frame_period_ns),
            late_chunk: None,
            rhythm: Rhythm::default(),
            latest_ns: 0,
            epoch: epoch_after(0, begin),
            settings,
        }
    }

    /// How stamps make model steps.
    pub fn timing(&self) -> Timing {
        self.settings.timing
    }

    /// The space of its latents.
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// How physical actions become the model's.
    pub fn encoding(&self) -> &ActionEncoding {
        &self.encoding
    }

    /// The epoch of the history. Later epochs have greater numbers; results of an earlier epoch are out of date.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Takes a latent.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped, and the history does not change.
    pub fn latent(
        &mut self,
        latent: &Latent,
        reception: Reception,
    ) -> Result<Arrival, HistoryError> {
        let observation = Observation {
            header: &latent.header,
            values: decode_latent(latent, &self.space)?.into(),
            epoch: latent.epoch,
            is_frozen: latent.frozen,
        };
        self.observe(observation, reception)
    }

    /// Takes a latent of the history's space.
    ///
    /// # Errors
    /// As [`Self::latent`].
    pub fn observe(
        &mut self,
        observation: Observation<'_>,
        reception: Reception,
    ) -> Result<Arrival, HistoryError> {
        let Observation {
            header,
            values,
            epoch: source_epoch,
            is_frozen,
        } = observation;
        let stamp_ns = stamp_of_frame(header.stamp, &reception)?;
        let mut arrival = Arrival::default();
        let frame_id = header.frame_id.as_str();
        match &mut self.camera {
            None => {
                self.camera = Some(Camera::new(frame_id, Source::Latents, &reception));
                self.source_epoch = source_epoch;
            }
            Some(camera) => {
                let period =
                    Duration::from_nanos(self.settings.timing.frame_period_ns.unsigned_abs());
                // A slow encoder is silent for longer.
                let usual = Duration::from_nanos(self.rhythm.longest_ns().unsigned_abs());
                let silence = (period * SILENT_FRAMES)
                    .max(Duration::from_secs(1))
                    .max(usual * 2);
                let admission = camera.admit(frame_id, Source::Latents, &reception, silence)?;
                if admission == Admission::Same && source_epoch < self.source_epoch {
                    return Err(HistoryError::OldEpoch {
                        epoch: source_epoch,
                        newest: self.source_epoch,
                    });
                }
                if admission == Admission::TakenOver || source_epoch > self.source_epoch {
                    self.source_epoch = source_epoch;
                    if admission == Admission::TakenOver {
                        self.camera_clock.restart();
                    }
                    self.begin_around(stamp_ns, reception.stamp);
                    arrival.flushed = true;
                }
            }
        }
        let camera = self.camera.as_ref();
        let frame = Frame {
            stamp_ns,
            // An empty one stands for any of the same publisher.
            frame_id: camera
                .map_or_else(|| frame_id.into(), |camera| Arc::clone(camera.frame_id())),
            values,
            is_frozen,
            reception,
        };
        self.frame(frame, arrival)
    }

    fn frame(&mut self, frame: Frame, mut arrival: Arrival) -> Result<Arrival, HistoryError> {
        let (stamp_ns, timing) = (frame.stamp_ns, self.timing());
        let newest = self.frames.newest().map(|newest| newest.stamp_ns);
        match newest {
            None => {
                self.motion
                    .retain_around(stamp_ns, timing.jump_ns.max(FAR_AHEAD_NS));
            }
            Some(newest_ns) if self.is_jump(&frame, newest_ns) => {
                match self.held_back.confirm(frame, timing.jump_ns) {
                    None => {
                        arrival.held_back = true;
                        return Ok(arrival);
                    }
                    Some((before, now)) => {
                        let clock = now.reception.stamp;
                        self.camera_jumped(&now);
                        self.begin_around(before.stamp_ns, clock);
                        let first = self.frame(before, Arrival::default())?;
                        let mut arrival = self.frame(now, first)?;
                        arrival.flushed = true;
                        arrival.camera_step = self.camera_clock.step();
                        return Ok(arrival);
                    }
                }
            }
            Some(newest_ns) if stamp_ns == newest_ns => {
                return Err(HistoryError::Duplicate { stamp_ns });
            }
            Some(newest_ns) if stamp_ns < newest_ns => {
                return Err(HistoryError::OutOfOrder {
                    what: "frame",
                    stamp_ns,
                    newest_ns,
                });
            }
            Some(newest_ns) => {
                arrival.missed_frames = self.rhythm.missed(stamp_ns - newest_ns, &timing);
            }
        }
        arrival.untimely += self.held_back.discard();
        // Where time jumped back, the chunk was of the time that begins.
        let late_chunk = self.late_chunk.take();
        arrival.late_chunk = late_chunk.filter(|late| late.end_ns <= stamp_ns);
        self.keep_actions(stamp_ns);
        self.frames.push(frame);
        let is_whole = self.context(stamp_ns).is_ok();
        self.rhythm.context(is_whole);
        let camera_ns = self.frames.period_ns().unwrap_or(timing.frame_period_ns);
        self.pace.set_gap(camera_ns);
        arrival.is_due = self.pace.is_due(stamp_ns);
        if self.slow_camera().is_some() {
            // Not reported as missing frames.
            arrival.missed_frames = 0;
        }
        Ok(arrival)
    }

    /// Takes an action that the robot took; one of the same stamp replaces the earlier one.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
        let sent_ns = stamp_of("action", action.header.stamp, now, AHEAD_NS)?;
        let values = self.parse(action, || "action".into())?;
        let newest = self.frames.newest().map(|newest| newest.stamp_ns);
        let tolerance_ns = self.clock_tolerance_ns();
        let stamp_ns = self.camera_clock.action(sent_ns, newest, tolerance_ns);
        self.expect_near("action", stamp_ns, sent_ns, now)?;
        let base_frame = action.header.frame_id.as_str();
        if *self.base_frame != *base_frame {
            self.base_frame = base_frame.into();
        }
        if self.is_before_jump(stamp_ns) {
            self.held_back.action(stamp_ns, values);
            return Ok(Arrival {
                held_back: true,
                ..Arrival::default()
            });
        }
        self.motion.take(stamp_ns, values);
        Ok(Arrival::default())
    }

    /// Takes a chunk of coming actions; it replaces earlier chunks for the same time, or is merged with them.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped, and the previous one stays.
    pub fn chunk(&mut self, chunk: &ActionChunk, now: Time) -> Result<Arrival, HistoryError> {
        let sent_ns = stamp_of("action chunk", chunk.header.stamp, now, ANNOUNCED_NS)?;
        let stamp_ns = self.camera_clock.in_camera_time(sent_ns);
        self.expect_near("action chunk", stamp_ns, sent_ns, now)?;
        let actions = chunk
            .actions
            .iter()
            .enumerate()
            .map(|(index, action)| self.parse(action, || format!("action {index} of a chunk")));
        let actions = actions.collect::<Result<Vec<_>, _>>()?;
        let space = self.encoding.space();
        let parsed = Chunk::new(space, stamp_ns, period_of(chunk)?, actions);
        let parsed = parsed.map_err(HistoryError::Chunk)?;
        // A policy may be slow: what counts is whether any of its actions is of this time.
        if self.is_before_jump(parsed.end_ns()) {
            self.held_back.chunk(parsed);
            return Ok(Arrival {
                held_back: true,
                ..Arrival::default()
            });
        }
        if let Some(newest_ns) = self.motion.announced_ns()
            && stamp_ns < newest_ns
        {
            return Err(HistoryError::OutOfOrder {
                what: "action chunk",
                stamp_ns,
                newest_ns,
            });
        }
        let end_ns = parsed.end_ns();
        self.motion.announce(parsed, self.encoding.space());
        let newest = self.frames.newest().map(|frame| frame.stamp_ns);
        self.late_chunk = newest
            .filter(|newest_ns| end_ns <= *newest_ns)
            .map(|newest_ns| LateChunk {
                stamp_ns,
                end_ns,
                newest_ns,
            });
        let timing = self.timing();
        let answers = |newest_ns: i64| {
            end_ns > newest_ns
                && stamp_ns <= newest_ns.saturating_add(timing.tolerance_ns)
                && stamp_ns > newest_ns.saturating_sub(timing.step_ns())
        };
        Ok(Arrival {
            is_due: newest.is_some_and(answers),
            ..Arrival::default()
        })
    }

    /// Handles a jump of the node's clock back to `now`; returns whether a new epoch began. Inputs that already have
    /// stamps of the new time stay.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        let now_ns = now.to_nanos();
        let newest = self.frames.newest().map(|frame| frame.stamp_ns);
        let newest = newest.max(self.motion.newest_taken_ns());
        let jump_ns = self.timing().jump_ns;
        if newest.is_none_or(|newest_ns| now_ns >= newest_ns.saturating_sub(jump_ns)) {
            return false;
        }
        self.camera_clock.restart();
        self.begin_around(now_ns, now);
        true
    }

    /// Continues the history `before` in a new epoch: with its actions if they are this history's, and with its frames
    /// if their latents are too. Returns whether both are.
    pub fn continue_from(&mut self, before: &Self, now: Time) -> bool {
        let epoch = epoch_after(before.epoch, now);
        let own = self.encoding.space();
        let has_same_actions = self.settings == before.settings
            && own.expect_same(before.encoding.space(), "", "").is_ok();
        let is_same = has_same_actions && self.space == before.space;
        if has_same_actions {
            *self = Self {
                space: self.space.clone(),
                encoding: self.encoding.clone(),
                ..before.clone()
            };
            if !is_same {
                // The encoder sends the last frames again, in this space, and the first one names the camera.
                self.camera = None;
                self.held_back.discard();
                self.begin(now);
            }
        }
        self.epoch = epoch;
        is_same
    }

    /// Forgets everything and begins a new epoch.
    pub fn reset(&mut self, now: Time) {
        self.motion.clear();
        self.held_back.discard();
        self.begin(now);
    }

    /// The newest frame.
    pub fn newest(&self) -> Option<&Frame> {
        self.frames.newest()
    }

    /// Whether the camera had stopped by the newest frame.
    pub fn is_frozen(&self) -> bool {
        self.newest().is_some_and(|newest| newest.is_frozen)
    }

    /// The frame nearest to a stamp, if one lies within the tolerance.
    pub fn near(&self, stamp_ns: i64) -> Option<&Frame> {
        self.frames.near(stamp_ns, self.timing().tolerance_ns)
    }

    fn parse(
        &self,
        action: &Action,
        what: impl FnOnce() -> String,
    ) -> Result<Arc<[f32]>, HistoryError> {
        match self.encoding.space().check(&action.values) {
            Ok(()) => Ok(action.values.as_slice().into()),
            Err(source) => Err(HistoryError::Action {
                what: what(),
                source,
            }),
        }
    }

    /// Whether a frame's stamp shows a jump of time. Frames that are far apart because as much time has passed, like
    /// those of a slow encoder, show none.
    fn is_jump(&self, frame: &Frame, newest_ns: i64) -> bool {
        let gap_ns = frame.stamp_ns.saturating_sub(newest_ns);
        let passed_ns = match self.frames.newest() {
            Some(newest) if gap_ns > 0 => rhythm::passed_ns(&newest.reception, &frame.reception),
            _ => 0,
        };
        gap_ns
            .saturating_sub(passed_ns)
            .max(gap_ns.saturating_neg())
            > self.timing().jump_ns
    }

    /// How far the newest action may lie from the newest frame if both are of one clock.
    fn clock_tolerance_ns(&self) -> i64 {
        self.timing().jump_ns.saturating_add(self.latest_ns)
    }

    /// Determines whether a jump of the frames to `now` is one of the camera's clock alone.
    fn camera_jumped(&mut self, now: &Frame) {
        let Some(from) = self.frames.newest() else {
            return;
        };
        let passed = now
            .reception
            .at
            .saturating_duration_since(from.reception.at);
        // 64 bits of nanoseconds hold 292 years.
        let passed_ns = i64::try_from(passed.as_nanos()).unwrap_or(i64::MAX);
        let gap_ns = now.stamp_ns.saturating_sub(from.stamp_ns);
        let by_ns = gap_ns.saturating_sub(passed_ns);
        let (from_ns, tolerance_ns) = (from.stamp_ns, self.clock_tolerance_ns());
        self.camera_clock
            .jumped(from_ns, now.stamp_ns, by_ns, tolerance_ns);
    }

    /// The step of the camera's clock, if it and the clock of the actions do not agree.
    pub fn camera_step(&self) -> Option<CameraStep> {
        self.camera_clock.step()
    }

    /// Keeps actions long enough for frames that arrive as late as this one.
    fn keep_actions(&mut self, stamp_ns: i64) {
        let late_ns = (self.motion.newest_taken_ns())
            .map_or(0, |newest_ns| newest_ns.saturating_sub(stamp_ns));
        self.latest_ns = self.latest_ns.max(late_ns);
        let timing = self.timing();
        let span_ns = timing.step_at(0, self.settings.context_frames.max(1));
        let keep_ns = span_ns
            .saturating_add(timing.jump_ns)
            .saturating_add(self.latest_ns.saturating_mul(KEPT_AGES));
        self.motion
            .keep_for(keep_ns.min(KEPT_AT_FIRST_NS.max(span_ns)));
    }

    /// Whether a stamp lies so far back that it belongs to an earlier epoch.
    fn is_before_jump(&self, stamp_ns: i64) -> bool {
        let newest = self.frames.newest();
        newest
            .is_some_and(|newest| stamp_ns < newest.stamp_ns.saturating_sub(self.timing().jump_ns))
    }

    /// Checks that a stamp (`stamp_ns` in the camera's time, `sent_ns` in its sender's) is not far ahead.
    fn expect_near(
        &self,
        what: &'static str,
        stamp_ns: i64,
        sent_ns: i64,
        now: Time,
    ) -> Result<(), HistoryError> {
        match self.frames.newest() {
            Some(newest) if stamp_ns > newest.stamp_ns.saturating_add(FAR_AHEAD_NS) => {
                let age_ns = now.to_nanos().saturating_sub(sent_ns);
                let behind_ns = newest
                    .reception
                    .stamp
                    .to_nanos()
                    .saturating_sub(newest.stamp_ns);
                if age_ns.saturating_abs() < ANNOUNCED_NS && behind_ns > ANNOUNCED_NS {
                    let behind_s = behind_ns as f64 / 1e9;
                    return Err(HistoryError::CameraBehind { what, behind_s });
                }
                Err(HistoryError::Ahead {
                    what,
                    stamp_ns,
                    newest_ns: newest.stamp_ns,
                })
            }
            _ => Ok(()),
        }
    }

    /// Begins a new epoch at a time that has jumped to `stamp_ns`. Actions outrun frames, which pass through the
    /// encoder first: those around the new time belong to it and stay.
    fn begin_around(&mut self, stamp_ns: i64, now: Time) {
        let jump_ns = self.timing().jump_ns;
        self.motion.retain_around(stamp_ns, jump_ns);
        let space = self.encoding.space();
        self.held_back
            .release(&mut self.motion, space, stamp_ns, jump_ns);
        self.begin(now);
    }

    fn begin(&mut self, now: Time) {
        self.frames.clear();
        self.rhythm = Rhythm::default();
        self.latest_ns = 0;
        self.pace.restart();
        self.late_chunk = None;
        self.epoch = epoch_after(self.epoch, now);
    }
}

/// The number of a new epoch: from the clock, so that it exceeds those before a restart, and always greater than `last`.
pub(crate) fn epoch_after(last: u64, now: Time) -> u64 {
    // A clock before 1970 is not set: the epochs count from the last one.
    let by_clock = u64::try_from(now.to_nanos()).unwrap_or(0);
    by_clock.max(last.saturating_add(1))
}

#[cfg(test)]
mod tests;
