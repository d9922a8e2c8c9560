//! The command of the next command period.

use std::time::Duration;

use super::{Cause, Command, ExecutorStep, JUMP_NS, Moment, Output, Phase, Refusal, Tick};
use crate::executor::{
    Rates, State, Status,
    schedule::{Change, PeriodMotion},
};

impl ExecutorStep {
    /// The command of the period that begins now. Call it once per period.
    pub fn tick(&mut self, now: Moment) -> Tick {
        let since = self
            .last
            .map(|last| now.at.saturating_duration_since(last.at));
        // A tick that is late may make up for the last one, but a pause is no reason for a jerk.
        let period = self.settings.period;
        let seconds = since.unwrap_or(period).min(2 * period).as_secs_f64();
        if self
            .last
            .is_some_and(|last| now.stamp_ns < last.stamp_ns - JUMP_NS)
        {
            self.jump();
        }
        self.last = Some(now);
        self.settings.clock.see(now);
        let mut refused = self.expire(now);
        if matches!(self.phase, Phase::Stopped(_)) {
            // All at once: an emergency stop is the one step that no limit smooths.
            self.velocity = self.still();
        } else {
            let (motion, cause) = self.motion(now, &mut refused);
            let target = self.settings.limits.within(motion.velocity);
            self.gripper = motion.gripper.or(self.gripper);
            self.cause = cause.or((target != motion.velocity).then_some(Cause::Slowed));
            self.velocity = self.settings.limits.toward(self.velocity, target, seconds);
        }
        self.rest(now);
        self.go();
        Tick {
            output: self.output(),
            refused,
        }
    }

    /// The motion of this period, and the reason if it is not an offer's.
    fn motion(&mut self, now: Moment, refused: &mut Vec<Refusal>) -> (PeriodMotion, Option<Cause>) {
        let nothing = PeriodMotion {
            velocity: self.still(),
            gripper: None,
            running_out: None,
        };
        let leap_s = self.settings.clock.leap_s(now);
        if let Phase::Disarming(cause) = &self.phase {
            return (nothing, Some(cause.clone()));
        }
        if let Err(hold) = self.expect_free(now) {
            self.counts.interrupted += u64::from(self.schedule.clear());
            for _ in 0..self.waiting.len() {
                refused.push(Refusal::Held(hold.clone()));
            }
            self.counts.refused += self.waiting.len() as u64;
            self.waiting.clear();
            (self.over_ns, self.ease) = (None, None);
            return (nothing, Some(Cause::Held(hold)));
        }
        let cause = self.advance(now, leap_s, refused);
        let Some(mut motion) = self.offered(now).or_else(|| self.eased(now)) else {
            return (nothing, Some(cause.unwrap_or(Cause::Nothing)));
        };
        let mut cause = cause.filter(|_| self.schedule.current().is_none());
        if let Some(workspace) = &self.settings.workspace {
            let mut velocity = motion.velocity.velocity();
            match workspace.cut(velocity.linear, now.at) {
                Ok((linear, is_cut)) => {
                    velocity.linear = linear;
                    motion.velocity = velocity.into();
                    if is_cut.contains(&true) {
                        cause = Some(Cause::Cut(is_cut));
                    }
                }
                // `expect_free` has ruled this out.
                Err(hold) => return (nothing, Some(Cause::Held(hold))),
            }
        }
        if let Some(joints) = &self.settings.joints {
            let is_cut;
            (motion.velocity, is_cut) = joints.cut(motion.velocity);
            if is_cut {
                cause = Some(Cause::CutJoints);
            }
        }
        (motion, cause)
    }

    /// Advances the schedule; returns the reason for the end of the last offer, if none has begun since.
    fn advance(
        &mut self,
        now: Moment,
        leap_s: Option<f64>,
        refused: &mut Vec<Refusal>,
    ) -> Option<Cause> {
        let before = self.cause.take();
        let (change, dropped) = self
            .schedule
            .advance(now, self.span_ns(), self.settings.max_age);
        for refusal in dropped {
            self.note(&refusal);
            refused.push(refusal);
        }
        if change.is_some() {
            (self.over_ns, self.ease) = (None, None);
        }
        match change {
            Some(Change::Begun) => {
                self.counts.begun += 1;
                self.refusal = None;
                if let Some(offer) = self.schedule.current() {
                    self.frame_id.clone_from(&offer.frame_id);
                }
                None
            }
            Some(Change::Over { end_ns }) => {
                if let Some(by_s) = leap_s {
                    self.counts.interrupted += 1;
                    return Some(Cause::ClockAhead(by_s));
                }
                self.over_ns = Some(end_ns);
                self.ease = self.is_eased(now).then_some((self.velocity, now.at));
                Some(Cause::Silence)
            }
            Some(Change::Stale) => {
                self.counts.interrupted += 1;
                Some(leap_s.map_or(Cause::Stale, Cause::ClockAhead))
            }
            Some(Change::Outrun) => {
                self.counts.interrupted += 1;
                Some(Cause::ClockSlow)
            }
            // Only the reason of an end stays; a hold is over.
            None => before.filter(Cause::is_end),
        }
    }

    /// The motion of the offers in this period. If their source is sometimes late and the last one ends within the
    /// period, its motion continues to the end of the period: the next offer may arrive.
    fn offered(&self, now: Moment) -> Option<PeriodMotion> {
        let joints = self.settings.joints.as_ref();
        let places = joints.and_then(|joints| joints.places());
        let places = places.unwrap_or(Rates::zero(0));
        let layout = &self.settings.layout;
        let mut motion = self
            .schedule
            .motion(now.stamp_ns, self.span_ns(), layout, places)?;
        let covered = motion.running_out.filter(|covered| *covered > 0.0);
        if let Some(covered) = covered.filter(|_| self.is_eased(now)) {
            motion.velocity = self.still().plus(motion.velocity, covered.recip());
        }
        Some(motion)
    }

    /// Whether the next offer may be late, and the arm does not stop by itself.
    fn is_eased(&self, now: Moment) -> bool {
        self.lateness.is_late_at_times(now.stamp_ns) && !self.settings.layout.has_positions()
    }

    /// After offers of a source that is sometimes late, the arm uses all of its time to stop: the next offer may arrive.
    fn eased(&self, now: Moment) -> Option<PeriodMotion> {
        let (velocity, since) = self.ease?;
        let passed = now.at.saturating_duration_since(since) + self.settings.period;
        let share = 1.0 - passed.as_secs_f64() / self.settings.stop_within.as_secs_f64().max(1e-3);
        (share > 0.0).then(|| PeriodMotion {
            velocity: self.still().plus(velocity, share),
            gripper: None,
            running_out: None,
        })
    }

    /// A command period \[ns\].
    fn span_ns(&self) -> i64 {
        // 64 bits of nanoseconds hold 292 years.
        i64::try_from(self.settings.period.as_nanos()).unwrap_or(i64::MAX)
    }

    /// The joints continue by the command, or rest at their positions.
    fn go(&mut self) {
        let seconds = self.settings.period.as_secs_f64();
        if let Some(joints) = &mut self.settings.joints {
            match self.is_busy {
                true => joints.go(self.velocity, seconds),
                false => joints.settle(),
            }
        }
    }

    /// Drops everything, because time jumped back: a bag begins again, or the clock was set.
    fn jump(&mut self) {
        self.forget();
        self.epoch = None;
        self.vetoes.clear();
        self.settings.clock.reset();
        self.settings.camera.forget_stamps();
        self.disarm(Cause::ClockJump);
    }

    /// Refuses offers that have waited too long for their assessments.
    fn expire(&mut self, now: Moment) -> Vec<Refusal> {
        let wait = self.vetoes.settings().wait;
        let mut refused = Vec::new();
        while let Some(first) = self.waiting.front() {
            let waited = now.at.saturating_duration_since(first.since);
            if waited <= wait && first.offer.end_ns() > now.stamp_ns {
                break;
            }
            self.waiting.pop_front();
            let refusal = Refusal::Unassessed {
                waited_s: waited.as_secs_f64(),
            };
            self.note(&refusal);
            refused.push(refusal);
        }
        refused
    }

    /// Sends zeros for a while after a motion, and then nothing.
    fn rest(&mut self, now: Moment) {
        let is_stopped = matches!(self.phase, Phase::Stopped(_));
        let is_active = !is_stopped && self.schedule.current().is_some();
        if is_active || !self.velocity.is_zero() {
            self.is_busy = true;
            self.rest = None;
            return;
        }
        let rest = *self.rest.get_or_insert(now.at);
        let rested = now.at.saturating_duration_since(rest);
        // The first zero goes out, however short the time.
        if rested > Duration::ZERO && rested >= self.settings.zero_for {
            self.is_busy = false;
        }
        if !self.is_busy && matches!(self.phase, Phase::Disarming(_)) {
            self.phase = Phase::DryRun;
        }
    }

    fn output(&self) -> Output {
        if !self.is_busy {
            return Output::Silent;
        }
        let command = Command {
            velocity: self.velocity,
            places: self
                .settings
                .joints
                .as_ref()
                .and_then(|joints| joints.places()),
            gripper: self.gripper,
        };
        match self.phase {
            Phase::DryRun => Output::Preview(command),
            Phase::Armed | Phase::Disarming(_) | Phase::Stopped(_) => Output::Send(command),
        }
    }

    /// The state, and the reason for it.
    pub fn status(&self) -> Status {
        let offer = match self.phase {
            Phase::DryRun | Phase::Armed => self.schedule.current(),
            Phase::Disarming(_) | Phase::Stopped(_) => None,
        };
        let state = match &self.phase {
            Phase::DryRun => State::DryRun,
            Phase::Armed if offer.is_some() => State::Executing,
            Phase::Armed if self.velocity.is_zero() => State::Idle,
            Phase::Armed | Phase::Disarming(_) => State::Stopping,
            Phase::Stopped(_) => State::Stopped,
        };
        let cause = match &self.phase {
            Phase::Disarming(cause) | Phase::Stopped(cause) => Some(cause),
            Phase::DryRun | Phase::Armed => self.cause.as_ref(),
        };
        let mut parts = Vec::new();
        if self.phase == Phase::DryRun {
            parts.push("not armed".to_owned());
        }
        parts.extend(cause.map(ToString::to_string));
        if let Some(refusal) = &self.refusal {
            parts.push(format!("last refused: {refusal}"));
        }
        Status {
            state,
            reason: parts.join("; "),
            hold: match cause {
                Some(Cause::Held(hold)) => Some(hold.reason()),
                _ => None,
            },
            offer_ns: offer.map(|offer| offer.stamp_ns),
            counts: self.counts,
        }
    }
}
