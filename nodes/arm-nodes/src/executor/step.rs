//! The executor's state.

mod aim;
mod intake;

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use thiserror::Error;
use wm_frames::pose;
use wm_msgs::{
    geometry_msgs::PoseStamped, sensor_msgs::JointState, std_msgs::Header, wm_msgs::CameraState,
};

use super::{
    Cause, Counts, JointError, LateNotice, Moment, Offer, PoseError, Rates, Refusal, Settings,
    StopSources, lateness::Lateness, refusal::stamp_of, schedule::Schedule, veto::Vetoes,
};

/// A clock that goes back by less is being adjusted; by more, it was set.
const JUMP_NS: i64 = 100_000_000;

/// What is to be done in a command period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Velocity along each axis for the whole period.
    pub velocity: Rates,
    /// Where the joints are at its end, where it is joints that move \[rad or m\].
    pub places: Option<Rates>,
    /// The gripper's opening, 0 closed to 1 open; none where none was told yet.
    pub gripper: Option<f64>,
}

/// What to do with a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// There is none.
    Silent,
    /// It may only be shown: the node is not armed.
    Preview(Command),
    /// It is for the arm.
    Send(Command),
}

/// What a command period brings.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The command.
    pub output: Output,
    /// Offers that waited in vain.
    pub refused: Vec<Refusal>,
}

/// What became of an offer that was not refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is executed from its stamp on.
    Accepted,
    /// It waits for its assessment.
    Waiting,
}

/// Why the node cannot be armed or reset.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum ArmError {
    /// An emergency stop is latched.
    #[error("stopped: call ~/reset first")]
    Stopped,
    /// It has been disarmed, and has yet to stand still.
    #[error("still coming to a stop: call again in a moment")]
    Stopping,
    /// Somebody still asks for the emergency stop.
    #[error("the topic emergency_stop still says true")]
    Pressed,
    /// The emergency stop has no publisher, but needs one.
    #[error(
        "no publisher of emergency_stop is connected; expected one, since require_emergency_stop is set"
    )]
    NoStop,
    /// A publisher of the emergency stop is not connected, and why.
    #[error("emergency_stop would not stop the arm: {0}")]
    StopMismatch(String),
}

/// Whether commands go out.
#[derive(Clone, Debug, PartialEq)]
enum Phase {
    DryRun,
    Armed,
    /// Disarmed: commands go out until the arm stands still.
    Disarming(Cause),
    Stopped(Cause),
}

struct Waiting {
    offer: Offer,
    received: Moment,
    since: Instant,
}

/// The executor's state: offers and measurements in, commands out.
pub struct ExecutorStep {
    settings: Settings,
    vetoes: Vetoes,
    phase: Phase,
    schedule: Schedule,
    waiting: VecDeque<Waiting>,
    /// The newest of all plans' epochs.
    epoch: Option<u64>,
    /// Of the last command.
    velocity: Rates,
    gripper: Option<f64>,
    /// Of the last offer that was begun.
    frame_id: String,
    last: Option<Moment>,
    /// Whether commands are made, zeros after a motion included, and since when they are zeros.
    is_busy: bool,
    rest: Option<Instant>,
    lateness: Lateness,
    /// When the last offer was over, if nothing has begun since \[ns\].
    over_ns: Option<i64>,
    /// How fast the arm was when an offer of a source that is late at times was over, and when that was.
    ease: Option<(Rates, Instant)>,
    /// Why the last command is what it is.
    cause: Option<Cause>,
    /// Why the last offer was refused, until one is begun.
    refusal: Option<String>,
    counts: Counts,
}

impl ExecutorStep {
    /// An executor that is not armed.
    pub fn new(settings: Settings) -> Self {
        let settings_frame = settings.base_frame.clone();
        // From rest to the greatest velocity and back.
        let least_s = 2.0 * settings.limits.stopping_time() + settings.period.as_secs_f64();
        let least = Duration::try_from_secs_f64(least_s).unwrap_or(Duration::MAX);
        Self {
            lateness: Lateness::new(settings.stop_within / 2, least),
            over_ns: None,
            ease: None,
            vetoes: Vetoes::new(settings.veto),
            velocity: Rates::zero(settings.layout.axes()),
            settings,
            phase: Phase::DryRun,
            schedule: Schedule::default(),
            waiting: VecDeque::new(),
            epoch: None,
            gripper: None,
            frame_id: settings_frame,
            last: None,
            is_busy: false,
            rest: None,
            cause: Some(Cause::Nothing),
            refusal: None,
            counts: Counts::default(),
        }
    }

    /// What can be chosen.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The frame of the commands: that of the offer.
    pub fn frame_id(&self) -> &str {
        &self.frame_id
    }

    /// Takes where the end effector is; it came at `at`.
    ///
    /// # Errors
    /// [`PoseError`]: it is dropped.
    pub fn pose(&mut self, pose: &PoseStamped, at: Instant) -> Result<(), PoseError> {
        let Header { stamp, frame_id } = &pose.header;
        stamp_of("ee_pose", *stamp)?;
        let expected = &self.settings.base_frame;
        if !expected.is_empty() && expected != frame_id {
            return Err(PoseError::Frame {
                expected: expected.clone(),
                actual: frame_id.clone(),
            });
        }
        let pose = pose::of_pose(&pose.pose)?;
        if let Some(workspace) = &mut self.settings.workspace {
            workspace.measure(pose.translation.vector.into(), at);
        }
        Ok(())
    }

    /// Takes where the joints are; it came at `at`.
    ///
    /// # Errors
    /// [`JointError`]: it is dropped.
    pub fn joints(&mut self, joints: &JointState, at: Instant) -> Result<(), JointError> {
        match &mut self.settings.joints {
            Some(known) => known.measure(joints, at),
            None => Ok(()),
        }
    }

    /// No velocity along any axis.
    fn still(&self) -> Rates {
        Rates::zero(self.settings.layout.axes())
    }

    /// Takes what the deadman switch says; it came at `at`.
    pub fn deadman(&mut self, is_held: bool, at: Instant) {
        if let Some(deadman) = &mut self.settings.deadman {
            deadman.set(is_held, at);
        }
    }

    /// Takes what the encoder reports about the camera; it came at `received`.
    ///
    /// # Errors
    /// [`Refusal::Stamp`]: it is dropped.
    pub fn camera(&mut self, state: &CameraState, received: Moment) -> Result<(), Refusal> {
        self.settings.camera.report(state, received)
    }

    /// Takes who is connected to the topic of the emergency stop. An armed arm stops if one of them is gone, or if one
    /// could not stop it.
    pub fn stop_sources(&mut self, sources: StopSources) {
        if let Some(cause) = self.settings.emergency.connect(sources) {
            self.disarm(cause);
        }
    }

    /// A source that is late, once.
    pub fn take_late_notice(&mut self) -> Option<LateNotice> {
        self.lateness.take_notice()
    }

    /// Takes the newest message of the emergency stop's topic.
    pub fn emergency(&mut self, is_pressed: bool) {
        self.settings.emergency.press(is_pressed);
        if is_pressed {
            self.stop("the topic emergency_stop says true");
        }
    }

    /// The emergency stop; `by` says who asked for it how. The next command is zero, and the node is disarmed until
    /// [`Self::reset`] and [`Self::arm`]. False where it was stopped already.
    pub fn stop(&mut self, by: &str) -> bool {
        if matches!(self.phase, Phase::Stopped(_)) {
            return false;
        }
        self.is_busy = self.phase != Phase::DryRun;
        self.rest = None;
        self.velocity = self.still();
        if let Some(joints) = &mut self.settings.joints {
            // Where they are, not where they were told to go.
            joints.settle();
        }
        self.gripper = None;
        self.forget();
        self.phase = Phase::Stopped(Cause::Emergency(by.to_owned()));
        true
    }

    /// Who asked for the emergency stop, once that is known.
    pub fn name_stopper(&mut self, by: String) {
        if let Phase::Stopped(cause) = &mut self.phase {
            *cause = Cause::Emergency(by);
        }
    }

    /// Ends an emergency stop, and forgets all that is known of offers and predictions, and an encoder that has ended. The
    /// node is not armed.
    ///
    /// # Errors
    /// [`ArmError::Pressed`]: the emergency stop's topic still says true.
    pub fn reset(&mut self) -> Result<(), ArmError> {
        self.settings.emergency.expect_released()?;
        self.settings.camera.reset();
        self.epoch = None;
        self.vetoes.clear();
        match self.phase {
            Phase::Stopped(_) => {
                self.phase = Phase::DryRun;
                self.is_busy = false;
            }
            Phase::Armed => self.disarm(Cause::Disarmed),
            Phase::DryRun | Phase::Disarming(_) => {}
        }
        self.forget();
        Ok(())
    }

    /// From now on commands go out. What was tried out before is forgotten: the first motion is that of an offer that
    /// comes later.
    ///
    /// # Errors
    /// [`ArmError`] says why not.
    pub fn arm(&mut self) -> Result<(), ArmError> {
        match self.phase {
            Phase::Armed => return Ok(()),
            Phase::Stopped(_) => return Err(ArmError::Stopped),
            Phase::Disarming(_) => return Err(ArmError::Stopping),
            Phase::DryRun => {}
        }
        self.settings.emergency.expect_connected()?;
        self.forget();
        self.velocity = self.still();
        if let Some(joints) = &mut self.settings.joints {
            joints.settle();
        }
        self.gripper = None;
        self.is_busy = false;
        self.cause = Some(Cause::Nothing);
        self.phase = Phase::Armed;
        Ok(())
    }

    /// Commands decelerate to zero, and then none go out.
    pub fn disarm(&mut self, cause: Cause) {
        if self.phase == Phase::Armed {
            self.forget();
            self.phase = Phase::Disarming(cause);
        }
    }

    /// Forgets all offers.
    fn forget(&mut self) {
        self.counts.interrupted += u64::from(self.schedule.clear());
        // A length fits.
        self.counts.refused += self.waiting.len() as u64;
        self.waiting.clear();
        self.refusal = None;
        (self.over_ns, self.ease) = (None, None);
        self.lateness.reset();
    }

    fn note(&mut self, refusal: &Refusal) {
        self.counts.refused += 1;
        self.counts.vetoed += u64::from(matches!(refusal, Refusal::Vetoed(_)));
        self.refusal = Some(refusal.to_string());
    }
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
