//! The goals of an action server: their states, the clients that wait for results, and how long results are kept. The
//! rules are rcl_action's; no DDS and no clock.

use super::{GoalId, GoalStatus};
use std::time::{Duration, Instant};
use wm_msgs::{
    action_msgs::{
        CancelGoalRequest, CancelGoalResponse, GoalInfo, GoalStatus as StatusMessage,
        GoalStatusArray,
    },
    builtin_interfaces::Time,
    unique_identifier_msgs::UUID,
};

/// Most goals under way; more are rejected. Bounds the memory.
pub(super) const MOST_LIVE: usize = 64;
/// Most results kept; the oldest is dropped first. Bounds the memory.
pub(super) const MOST_ENDED: usize = 64;
/// How long a result is kept, as the design of actions recommends. rcl has 10 s, too short for a client that reconnects
/// over a bad link.
pub(super) const RESULT_TIMEOUT: Duration = Duration::from_secs(15 * 60);
/// Most requests that wait for one goal's result; the oldest is dropped first, since its client has most likely given
/// up.
pub(super) const MOST_WAITING: usize = 64;

/// The goals that a server knows. `R`: a result, `W`: a client that waits for one.
pub(super) struct Goals<R, W> {
    /// In order of acceptance.
    goals: Vec<Goal<R, W>>,
}

struct Goal<R, W> {
    id: GoalId,
    accepted: Time,
    state: State<R, W>,
}

enum State<R, W> {
    Live { phase: Phase, waiting: Vec<W> },
    Ended { end: End, result: R, at: Instant },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Accepted,
    Executing,
    Canceling,
}

/// How a goal ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Succeeded,
    Canceled,
    Aborted,
}

impl End {
    pub(super) const fn status(self) -> GoalStatus {
        match self {
            Self::Succeeded => GoalStatus::Succeeded,
            Self::Canceled => GoalStatus::Canceled,
            Self::Aborted => GoalStatus::Aborted,
        }
    }
}

/// Why a goal is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RejectReason {
    /// Another goal has its id.
    Known,
    /// [`MOST_LIVE`] are under way.
    Full,
}

impl RejectReason {
    pub(super) const fn reason(self) -> &'static str {
        match self {
            Self::Known => "there is a goal with its id",
            Self::Full => "too many goals are under way",
        }
    }
}

/// The reply to a request for a result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Availability<R> {
    /// The goal has ended.
    Ended(R),
    /// The reply follows when the goal ends. `forgot`: an older request was dropped for it.
    Later { forgot: bool },
    /// The goal is unknown, or no longer kept.
    Unknown,
}

impl<R, W> Default for Goals<R, W> {
    fn default() -> Self {
        Self { goals: Vec::new() }
    }
}

impl<R, W> Goal<R, W> {
    fn status(&self) -> GoalStatus {
        match self.state {
            State::Live { phase, .. } => match phase {
                Phase::Accepted => GoalStatus::Accepted,
                Phase::Executing => GoalStatus::Executing,
                Phase::Canceling => GoalStatus::Canceling,
            },
            State::Ended { end, .. } => end.status(),
        }
    }

    fn info(&self) -> GoalInfo {
        GoalInfo {
            goal_id: self.id.into(),
            stamp: self.accepted,
        }
    }

    /// Cancels it; whether that changed anything.
    fn cancel(&mut self) -> bool {
        match &mut self.state {
            State::Live { phase, .. } if *phase != Phase::Canceling => {
                *phase = Phase::Canceling;
                true
            }
            _ => false,
        }
    }
}

impl<R: Clone, W> Goals<R, W> {
    fn find(&self, id: GoalId) -> Option<&Goal<R, W>> {
        self.goals.iter().find(|goal| goal.id == id)
    }

    fn find_mut(&mut self, id: GoalId) -> Option<&mut Goal<R, W>> {
        self.goals.iter_mut().find(|goal| goal.id == id)
    }

    /// The status of a goal; `None` if it is unknown.
    pub(super) fn status(&self, id: GoalId) -> Option<GoalStatus> {
        self.find(id).map(Goal::status)
    }

    /// Checks whether [`accept`](Self::accept) would reject it.
    pub(super) fn refuses(&self, id: GoalId) -> Option<RejectReason> {
        let is_live = |goal: &&Goal<R, W>| !goal.status().is_end();
        if self.find(id).is_some() {
            Some(RejectReason::Known)
        } else if self.goals.iter().filter(is_live).count() >= MOST_LIVE {
            Some(RejectReason::Full)
        } else {
            None
        }
    }

    /// Accepts a goal.
    pub(super) fn accept(
        &mut self,
        id: GoalId,
        accepted: Time,
        now: Instant,
    ) -> Result<(), RejectReason> {
        self.expire(now);
        if let Some(refused) = self.refuses(id) {
            return Err(refused);
        }
        let state = State::Live {
            phase: Phase::Accepted,
            waiting: Vec::new(),
        };
        self.goals.push(Goal {
            id,
            accepted,
            state,
        });
        Ok(())
    }

    /// Begins to execute a goal that was accepted; whether that changed anything.
    pub(super) fn execute(&mut self, id: GoalId) -> bool {
        match self.find_mut(id).map(|goal| &mut goal.state) {
            Some(State::Live { phase, .. }) if *phase == Phase::Accepted => {
                *phase = Phase::Executing;
                true
            }
            _ => false,
        }
    }

    /// Cancels the goals that the request selects.
    pub(super) fn cancel(&mut self, request: &CancelGoalRequest) -> CancelGoalResponse {
        let GoalInfo { goal_id, stamp } = request.goal_info;
        let answer = |return_code, goals_canceling| CancelGoalResponse {
            return_code,
            goals_canceling,
        };
        let (has_id, has_stamp) = (goal_id != UUID::default(), stamp.to_nanos() != 0);
        if has_id && !has_stamp {
            return match self.find_mut(goal_id.into()) {
                None => answer(CancelGoalResponse::ERROR_UNKNOWN_GOAL_ID, Vec::new()),
                Some(goal) => match goal.cancel() {
                    true => answer(CancelGoalResponse::ERROR_NONE, vec![goal.info()]),
                    // also for goals that are being canceled already, as in rcl_action
                    false => answer(CancelGoalResponse::ERROR_GOAL_TERMINATED, Vec::new()),
                },
            };
        }
        let is_all = !has_id && !has_stamp;
        let mut canceling = Vec::new();
        for goal in &mut self.goals {
            let is_meant = is_all
                || UUID::from(goal.id) == goal_id
                || goal.accepted.to_nanos() <= stamp.to_nanos();
            if is_meant && goal.cancel() {
                canceling.push(goal.info());
            }
        }
        answer(CancelGoalResponse::ERROR_NONE, canceling)
    }

    /// Requests the result of a goal.
    pub(super) fn ask(&mut self, id: GoalId, who: W, now: Instant) -> Availability<R> {
        self.expire(now);
        match self.find_mut(id).map(|goal| &mut goal.state) {
            None => Availability::Unknown,
            Some(State::Ended { result, .. }) => Availability::Ended(result.clone()),
            Some(State::Live { waiting, .. }) => {
                let forgot = waiting.len() >= MOST_WAITING;
                if forgot {
                    waiting.remove(0);
                }
                waiting.push(who);
                Availability::Later { forgot }
            }
        }
    }

    /// Ends a goal; `result` encodes its result. Returns the result and the clients that wait for it. Only a goal whose
    /// cancellation was requested can end as canceled; others are aborted instead. `None` if no such goal is under way.
    ///
    /// # Errors
    /// The error of `result`; the goal is then still under way.
    pub(super) fn end<E>(
        &mut self,
        id: GoalId,
        end: End,
        now: Instant,
        result: impl FnOnce(GoalStatus) -> Result<R, E>,
    ) -> Result<Option<(R, Vec<W>)>, E> {
        let Some(goal) = self.find_mut(id) else {
            return Ok(None);
        };
        let State::Live { phase, waiting } = &mut goal.state else {
            return Ok(None);
        };
        let end = match end {
            End::Canceled if *phase != Phase::Canceling => End::Aborted,
            end => end,
        };
        let result = result(end.status())?;
        let waiting = std::mem::take(waiting);
        goal.state = State::Ended {
            end,
            result: result.clone(),
            at: now,
        };
        self.expire(now);
        Ok(Some((result, waiting)))
    }

    /// Drops expired results, and the oldest if there are too many.
    fn expire(&mut self, now: Instant) {
        let ended = |goal: &Goal<R, W>| match goal.state {
            State::Ended { at, .. } => Some(at),
            State::Live { .. } => None,
        };
        let is_old = |at: Instant| now.saturating_duration_since(at) >= RESULT_TIMEOUT;
        self.goals.retain(|goal| !ended(goal).is_some_and(is_old));
        while self.goals.iter().filter_map(ended).count() > MOST_ENDED {
            let at = |(index, goal): (usize, &Goal<R, W>)| Some((ended(goal)?, index));
            let oldest = self.goals.iter().enumerate().filter_map(at).min();
            if let Some((_, index)) = oldest {
                self.goals.remove(index);
            }
        }
    }

    /// The status of every goal.
    pub(super) fn statuses(&self) -> GoalStatusArray {
        let status = |goal: &Goal<R, W>| StatusMessage {
            goal_info: goal.info(),
            status: goal.status().number(),
        };
        GoalStatusArray {
            status_list: self.goals.iter().map(status).collect(),
        }
    }
}

#[cfg(test)]
mod tests;
