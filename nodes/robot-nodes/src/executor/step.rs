//! The executor's state.

mod aim;
mod intake;

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use thiserror::Error;
use wm_msgs::{
    geometry_msgs::PoseStamped, sensor_msgs::JointState, std_msgs::Header, wm_msgs::CameraState,
};
use wm_ros::PublisherId;
use wm_wire::frames::pose;

use super::{
    Cause, Counts, JointError, LateNotice, Moment, Offer, PoseError, Rates, Refusal, Settings,
    StopSources, lateness::Lateness, refusal::stamp_of, schedule::Schedule, veto::Vetoes,
};

/// A clock that goes back by less is being adjusted; by more, it was set.
const JUMP_NS: i64 = 100_000_000;

/// The command of a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Velocity along each axis for the whole period.
    pub velocity: Rates,
    /// For an arm commanded by joints, their positions at the end \[rad or m\].
    pub places: Option<Rates>,
    /// The gripper's opening, 0 closed to 1 open; `None` before an offer has named it.
    pub gripper: Option<f64>,
}

/// The receiver of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// No command.
    Silent,
    /// The preview alone: the node is not armed.
    Preview(Command),
    /// The arm.
    Send(Command),
}

/// The result of a command period.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The command.
    pub output: Output,
    /// Refusals of offers that waited for an assessment or for their beginning.
    pub refused: Vec<Refusal>,
}

/// The result for an offer that was not refused.
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
    /// The newest message of a publisher of the emergency stop is true.
    #[error("a publisher of emergency_stop still publishes true")]
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

/// Whether commands are sent.
#[derive(Clone, Debug, PartialEq)]
enum Phase {
    DryRun,
    Armed,
    /// Disarmed: commands are sent until the arm stands still.
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

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The frame of the commands: that of the offer.
    pub fn frame_id(&self) -> &str {
        &self.frame_id
    }

    /// Capture time of the frame that the executed offer responds to \[ns\].
    pub fn executed_capture_ns(&self) -> Option<i64> {
        self.schedule.current()?.capture_ns
    }

    /// Takes the pose of the end effector.
    ///
    /// # Errors
    /// [`PoseError`]: it is dropped.
    pub fn pose(&mut self, pose: &PoseStamped, received: Moment) -> Result<(), PoseError> {
        let Header { stamp, frame_id } = &pose.header;
        let stamp_ns = stamp_of("ee_pose", *stamp)?;
        let expected = &self.settings.base_frame;
        if !expected.is_empty() && expected != frame_id {
            return Err(PoseError::Frame {
                expected: expected.clone(),
                actual: frame_id.clone(),
            });
        }
        let pose = pose::of_pose(&pose.pose)?;
        if let Some(workspace) = &mut self.settings.workspace {
            let age = received.age_of(stamp_ns);
            workspace.measure(pose.translation.vector.into(), received.at, age);
        }
        Ok(())
    }

    /// Takes positions of joints.
    ///
    /// # Errors
    /// [`JointError`]: it is dropped.
    pub fn joints(&mut self, joints: &JointState, received: Moment) -> Result<(), JointError> {
        match &mut self.settings.joints {
            Some(known) => known.measure(joints, received),
            None => Ok(()),
        }
    }

    /// Takes the present for the watchdog of the clock, between two commands.
    pub fn see_clock(&mut self, now: Moment) {
        self.settings.clock.see(now);
    }

    /// No velocity along any axis.
    fn still(&self) -> Rates {
        Rates::zero(self.settings.layout.axes())
    }

    /// Takes the state of the deadman switch, received at `at`.
    pub fn deadman(&mut self, is_held: bool, at: Instant) {
        if let Some(deadman) = &mut self.settings.deadman {
            deadman.set(is_held, at);
        }
    }

    /// Takes the encoder's report about the camera.
    ///
    /// # Errors
    /// [`Refusal::Stamp`]: it is dropped, unless it reports a stop.
    pub fn camera(&mut self, state: &CameraState, received: Moment) -> Result<(), Refusal> {
        self.settings.camera.report(state, received)
    }

    /// Takes the publishers of the emergency stop. An armed arm stops if one of them is gone, or is not connected.
    pub fn stop_sources(&mut self, sources: StopSources) {
        if let Some(cause) = self.settings.emergency.connect(sources) {
            self.disarm(cause);
        }
    }

    /// The report of a late source, once.
    pub fn take_late_notice(&mut self) -> Option<LateNotice> {
        self.lateness.take_notice()
    }

    /// Takes the newest message of a publisher of the emergency stop's topic.
    pub fn emergency(&mut self, publisher: PublisherId, is_pressed: bool) {
        self.settings.emergency.press(publisher, is_pressed);
        if is_pressed {
            self.stop("the topic emergency_stop is true");
        }
    }

    /// The emergency stop; `by` is its cause in words. The next command is zero, and the node is disarmed until
    /// [`Self::reset`] and [`Self::arm`]. False if it was stopped already.
    pub fn stop(&mut self, by: &str) -> bool {
        if matches!(self.phase, Phase::Stopped(_)) {
            return false;
        }
        self.is_busy = self.phase != Phase::DryRun;
        self.rest = None;
        self.velocity = self.still();
        if let Some(joints) = &mut self.settings.joints {
            // The measured positions, not the commanded ones.
            joints.settle();
        }
        self.gripper = None;
        self.forget();
        self.phase = Phase::Stopped(Cause::Emergency(by.to_owned()));
        true
    }

    /// Replaces the cause of the emergency stop.
    pub fn name_stopper(&mut self, by: String) {
        if let Phase::Stopped(cause) = &mut self.phase {
            *cause = Cause::Emergency(by);
        }
    }

    /// Ends an emergency stop, and drops all offers, predictions, and an encoder that has ended. The node is not armed.
    ///
    /// # Errors
    /// [`ArmError::Pressed`]: a publisher still presses the emergency stop.
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

    /// Starts to send commands. Offers of the dry run are dropped: the first motion is of a later offer.
    ///
    /// # Errors
    /// [`ArmError`] gives the reason.
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

    /// Commands decelerate to zero, and then stop.
    pub fn disarm(&mut self, cause: Cause) {
        if self.phase == Phase::Armed {
            self.forget();
            self.phase = Phase::Disarming(cause);
        }
    }

    /// Drops all offers.
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
