//! The executor's state.

mod aim;

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use thiserror::Error;
use wm_msgs::{
    geometry_msgs::PoseStamped,
    sensor_msgs::JointState,
    wm_msgs::{ActionCandidates, ActionChunk, Assessment, Plan, PredictionError},
};

use super::{
    Begin, Bounds, Cause, Deadman, Hold, JointError, Joints, Layout, Limits, Offer, PoseError,
    Rates, Refusal, VetoSettings, Workspace,
    schedule::Schedule,
    veto::{Verdict, Vetoes},
};

/// Chunks that may wait for their assessments.
const MOST_WAITING: usize = 8;
/// A clock that goes back by less is being adjusted; by more, it was set.
const JUMP_NS: i64 = 100_000_000;

/// What can be chosen of the executor.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where motions stand in actions.
    pub layout: Layout,
    /// The frame that actions and poses must have; empty: any.
    pub base_frame: String,
    /// Time from one command to the next.
    pub period: Duration,
    /// What a single action may be.
    pub bounds: Bounds,
    /// How fast the arm may move.
    pub limits: Limits,
    /// For how long after its reception an offer is executed.
    pub max_age: Duration,
    /// When an offer begins.
    pub begin: Begin,
    /// How far in the future an offer may begin.
    pub max_lead: Duration,
    /// For how long zeros are sent after a motion.
    pub zero_for: Duration,
    /// Whether offers are tried out while it is not armed.
    pub dry_run: bool,
    /// The box that the end effector has to stay in.
    pub workspace: Option<Workspace>,
    /// The joints, where it is joints that move.
    pub joints: Option<Joints>,
    /// The switch that has to be held.
    pub deadman: Option<Deadman>,
    /// Rules about predictions.
    pub veto: VetoSettings,
}

/// A moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Now {
    /// By a clock that never jumps.
    pub at: Instant,
    /// By the node's clock, which stamps go by \[ns\].
    pub stamp_ns: i64,
}

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

/// What the executor does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Not armed: nothing is sent.
    DryRun,
    /// Armed, and nothing to do.
    Idle,
    /// Armed, and an offer is executed.
    Executing,
    /// Commands decelerate to zero.
    Stopping,
    /// Emergency stop.
    Stopped,
}

/// What the executor does, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// What it does.
    pub state: State,
    /// Why it does not move, or not as it was told; empty if it does.
    pub reason: String,
    /// Stamp of the offer that is executed \[ns\].
    pub offer_ns: Option<i64>,
    /// Totals.
    pub counts: Counts,
}

/// Totals since the node's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Offers that were begun.
    pub begun: u64,
    /// Offers that were refused, those that waited in vain included.
    pub refused: u64,
    /// Offers that were vetoed.
    pub vetoed: u64,
    /// Offers that were cut short.
    pub interrupted: u64,
}

/// Why the node cannot be armed or reset.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
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
    received: Instant,
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
    last: Option<Now>,
    /// Whether commands are made, zeros after a motion included, and since when they are zeros.
    is_busy: bool,
    rest: Option<Instant>,
    /// Why the last command is what it is.
    cause: Option<Cause>,
    /// Why the last offer was refused, until one is begun.
    refusal: Option<String>,
    is_pressed: bool,
    counts: Counts,
}

impl ExecutorStep {
    /// An executor that is not armed.
    pub fn new(settings: Settings) -> Self {
        let settings_frame = settings.base_frame.clone();
        Self {
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
            is_pressed: false,
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

    /// Takes a policy's chunk that came at `received`.
    ///
    /// # Errors
    /// [`Refusal`]: it is not executed.
    pub fn chunk(
        &mut self,
        chunk: &ActionChunk,
        received: Instant,
        now: Now,
    ) -> Result<Taken, Refusal> {
        self.offer(Offer::of_chunk(chunk), received, now)
    }

    /// Takes a planner's plan that came at `received`.
    ///
    /// # Errors
    /// [`Refusal`]: it is not executed.
    pub fn plan(&mut self, plan: &Plan, received: Instant, now: Now) -> Result<Taken, Refusal> {
        self.offer(Offer::of_plan(plan), received, now)
    }

    /// Takes an offer that came at `received`.
    ///
    /// # Errors
    /// [`Refusal`]: it is not executed.
    pub fn offer(&mut self, offer: Offer, received: Instant, now: Now) -> Result<Taken, Refusal> {
        let taken = self.consider(offer, received, now);
        if let Err(refusal) = &taken {
            self.note(refusal);
        }
        taken
    }

    fn consider(
        &mut self,
        mut offer: Offer,
        received: Instant,
        now: Now,
    ) -> Result<Taken, Refusal> {
        match &self.phase {
            Phase::Armed => {}
            Phase::DryRun if self.settings.dry_run => {}
            Phase::DryRun | Phase::Disarming(_) => return Err(Refusal::NotArmed),
            Phase::Stopped(_) => return Err(Refusal::Stopped),
        }
        let settings = &self.settings;
        // What begins before all time would be over with the first message on /clock.
        if now.stamp_ns == 0 {
            return Err(Refusal::NoClock);
        }
        // Without joints no motion is free, and where they set out from is not known.
        if let Some(joints) = &settings.joints {
            joints.check(now.at)?;
        }
        let joints = settings.joints.as_ref();
        settings.bounds.check(&offer, &settings.layout, joints)?;
        if !settings.base_frame.is_empty() && settings.base_frame != offer.frame_id {
            return Err(Refusal::Frame {
                expected: settings.base_frame.clone(),
                actual: offer.frame_id,
            });
        }
        if let Some(actual) = offer.epoch {
            let newest = self.epoch.map_or(actual, |newest| newest.max(actual));
            self.epoch = Some(newest);
            if actual < newest {
                return Err(Refusal::Epoch { newest, actual });
            }
        }
        if settings.begin == Begin::Reception {
            offer.begin_ns = now.stamp_ns;
        }
        self.expect_timely(&offer, received, now)?;
        self.expect_free(now.at)?;
        match self.vetoes.judge(&offer) {
            Verdict::Veto(veto) => Err(veto.into()),
            Verdict::Pass => {
                self.schedule.push(offer, received)?;
                Ok(Taken::Accepted)
            }
            Verdict::Unassessed => {
                let since = now.at;
                self.waiting.push_back(Waiting {
                    offer,
                    received,
                    since,
                });
                if self.waiting.len() > MOST_WAITING {
                    self.waiting.pop_front();
                    self.note(&Refusal::Crowded {
                        waiting: MOST_WAITING,
                    });
                }
                Ok(Taken::Waiting)
            }
        }
    }

    fn expect_timely(&self, offer: &Offer, received: Instant, now: Now) -> Result<(), Refusal> {
        let seconds = |ns: i64| ns as f64 / 1e9;
        let mut age = now.at.saturating_duration_since(received);
        if self.settings.begin == Begin::Reception {
            // It would never be late: only its stamp tells that it waited somewhere else.
            let since_ns = now.stamp_ns.saturating_sub(offer.stamp_ns);
            age = age.max(Duration::from_nanos(u64::try_from(since_ns).unwrap_or(0)));
        }
        if age > self.settings.max_age {
            return Err(Refusal::Stale {
                age_s: age.as_secs_f64(),
                most_s: self.settings.max_age.as_secs_f64(),
            });
        }
        if offer.end_ns() <= now.stamp_ns {
            return Err(Refusal::Late {
                ago_s: seconds(now.stamp_ns.saturating_sub(offer.end_ns())),
            });
        }
        let ahead_s = seconds(offer.stamp_ns.saturating_sub(now.stamp_ns));
        let most_s = self.settings.max_lead.as_secs_f64();
        if ahead_s > most_s {
            return Err(Refusal::Early { ahead_s, most_s });
        }
        match self.schedule.newest_ns() {
            Some(newest_ns) if offer.made_ns < newest_ns => Err(Refusal::Older {
                before_s: seconds(newest_ns.saturating_sub(offer.made_ns)),
            }),
            _ => Ok(()),
        }
    }

    /// Whether all is there that a motion needs.
    fn expect_free(&self, now: Instant) -> Result<(), Hold> {
        if let Some(deadman) = &self.settings.deadman {
            deadman.check(now)?;
        }
        if let Some(workspace) = &self.settings.workspace {
            workspace.check(now)?;
        }
        if let Some(joints) = &self.settings.joints {
            joints.check(now)?;
            // What is only tried out moves nothing.
            if self.phase != Phase::DryRun {
                joints.check_following()?;
            }
        }
        Ok(())
    }

    /// Takes the chunks that a policy chooses from: an assessment refers to them.
    pub fn candidates(&mut self, candidates: &ActionCandidates) {
        self.vetoes.candidates(candidates);
    }

    /// Takes what the model predicts of a policy's candidates: those that waited for it go on, and one that is executed
    /// may be vetoed. Gives the offers that it speaks against.
    pub fn assessment(&mut self, assessment: &Assessment, now: Now) -> Vec<Refusal> {
        self.vetoes.assessment(assessment);
        let stamp_ns = assessment.candidates_stamp.to_nanos();
        let mut refused = Vec::new();
        let waiting = std::mem::take(&mut self.waiting);
        for waiting in waiting {
            if waiting.offer.stamp_ns != stamp_ns {
                self.waiting.push_back(waiting);
            } else if let Err(refusal) = self.consider(waiting.offer, waiting.received, now) {
                self.note(&refusal);
                refused.push(refusal);
            }
        }
        let vetoes = &self.vetoes;
        let (of_current, of_next) = self.schedule.veto(|offer| match vetoes.judge(offer) {
            Verdict::Veto(veto) if offer.stamp_ns == stamp_ns => Some(veto),
            _ => None,
        });
        if of_current.is_some() {
            self.counts.interrupted += 1;
            self.cause = Some(Cause::Vetoed);
        }
        // A length fits.
        self.counts.refused += of_next.len() as u64;
        for veto in of_current.into_iter().chain(of_next) {
            self.counts.vetoed += 1;
            let refusal = Refusal::Vetoed(veto);
            self.refusal = Some(refusal.to_string());
            refused.push(refusal);
        }
        refused
    }

    /// Takes what the last prediction was worth.
    pub fn prediction_error(&mut self, error: &PredictionError) {
        self.vetoes.prediction_error(error);
    }

    /// Takes where the end effector is; it came at `at`.
    ///
    /// # Errors
    /// [`PoseError`]: it is left out.
    pub fn pose(&mut self, pose: &PoseStamped, at: Instant) -> Result<(), PoseError> {
        let expected = &self.settings.base_frame;
        if !expected.is_empty() && *expected != pose.header.frame_id {
            return Err(PoseError::Frame {
                expected: expected.clone(),
                actual: pose.header.frame_id.clone(),
            });
        }
        let position = pose.pose.position;
        match &mut self.settings.workspace {
            Some(workspace) => workspace.measure([position.x, position.y, position.z], at),
            None => Ok(()),
        }
    }

    /// Takes where the joints are; it came at `at`.
    ///
    /// # Errors
    /// [`JointError`]: it is left out.
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

    /// Takes what the emergency stop's topic says.
    pub fn emergency(&mut self, is_pressed: bool) {
        self.is_pressed = is_pressed;
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

    /// Ends an emergency stop, and forgets all that is known of offers and predictions. The node is not armed.
    ///
    /// # Errors
    /// [`ArmError::Pressed`]: the emergency stop's topic still says true.
    pub fn reset(&mut self) -> Result<(), ArmError> {
        if self.is_pressed {
            return Err(ArmError::Pressed);
        }
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
