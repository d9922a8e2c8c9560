//! The goals of an action server: what becomes of them, who waits for their results, and which are still known. The
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

/// Goals that may be under way at once; more are refused. Bounds the memory.
pub(super) const MOST_LIVE: usize = 64;
/// Results that are kept; the oldest goes first. Bounds the memory.
pub(super) const MOST_ENDED: usize = 64;
/// How long a result is kept: what the design of actions recommends. (rcl has 10 s, which a client that comes back over a
/// bad link would miss.)
pub(super) const RESULT_TIMEOUT: Duration = Duration::from_secs(15 * 60);
/// Requests that may wait for one goal's result; the oldest, whose client has most likely given up, goes first.
pub(super) const MOST_WAITING: usize = 64;

/// The goals that a server knows. `R`: a result, `W`: who waits for one.
pub(super) struct Goals<R, W> {
    /// In the order in which they were accepted.
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

/// Why a goal is not taken on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refused {
    /// There is one with its id.
    Known,
    /// [`MOST_LIVE`] are under way.
    Full,
}

impl Refused {
    pub(super) const fn reason(self) -> &'static str {
        match self {
            Self::Known => "there is a goal with its id",
            Self::Full => "too many goals are under way",
        }
    }
}

/// What a request for a result leads to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Availability<R> {
    /// The goal has ended.
    Ended(R),
    /// It is answered when the goal ends; whether an older request was forgotten for it.
    Later { forgot: bool },
    /// There is no such goal, or no longer.
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

    /// How far a goal is; none where it is not known.
    pub(super) fn status(&self, id: GoalId) -> Option<GoalStatus> {
        self.find(id).map(Goal::status)
    }

    /// Whether [`accept`](Self::accept) would refuse it.
    pub(super) fn refuses(&self, id: GoalId) -> Option<Refused> {
        let is_live = |goal: &&Goal<R, W>| !goal.status().is_end();
        if self.find(id).is_some() {
            Some(Refused::Known)
        } else if self.goals.iter().filter(is_live).count() >= MOST_LIVE {
            Some(Refused::Full)
        } else {
            None
        }
    }

    /// Takes a goal on.
    pub(super) fn accept(
        &mut self,
        id: GoalId,
        accepted: Time,
        now: Instant,
    ) -> Result<(), Refused> {
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

    /// Cancels the goals that the request means.
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
                    // also where it is being canceled already: rcl_action says the same
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

    /// Asks for the result of a goal.
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

    /// Ends a goal: its result, of which `result` makes what is kept, and who waits for it. As the rules have it, only a
    /// goal that was to be canceled ends as canceled; another is aborted instead. None where there is no such goal under
    /// way.
    ///
    /// # Errors
    /// That of `result`; the goal is then still under way.
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

    /// Forgets results that are too old, and the oldest of those that are too many.
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

    /// How far all of them are.
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
