//! The planner's state.

use std::sync::Arc;

use thiserror::Error;
use wm_model::{LatentSpace, planner::PlannedActions};
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk, Latent},
};

use super::{Goal, PlannerError};
use crate::timeline::{Arrival, Context, Timeline, Timing, Wait};
use wm_wire::latent_message::decode_latent;

/// What can be chosen of when to plan and from what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlannerSettings {
    /// Frames that a plan starts from.
    pub context_frames: usize,
    /// Least time between the observations of two plans for one goal \[ns\].
    pub plan_period_ns: i64,
    /// Seed of the first plan; each later one adds 1, so that a plan does not repeat the candidates of the last.
    pub seed: u64,
}

/// All that a plan is computed from.
#[derive(Clone, Debug)]
pub struct PlanRequest {
    /// The timeline's epoch.
    pub epoch: u64,
    /// Context frames and the actions between them; the last frame is the observation.
    pub context: Context,
    /// The frame of the actions' deltas, as the robot names it; empty where no action has come.
    pub base_frame: Arc<str>,
    /// What to reach.
    pub goal: Goal,
    /// First mean of the search: the last plan for this goal, shifted by the model steps that have passed.
    pub start: Option<Vec<Vec<f32>>>,
    /// Seed of the candidates and of the noise.
    pub seed: u64,
    /// How stamps make model steps.
    pub timing: Timing,
}

/// Why there is nothing to plan.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlanWait {
    /// No goal is set.
    #[error("no goal image has come yet")]
    NoGoal,
    /// The history is not complete.
    #[error(transparent)]
    History(#[from] Wait),
    /// The last plan is younger than the plan period.
    #[error("the last plan is still recent")]
    Recent,
}

struct LastPlan {
    observed_ns: i64,
    actions: Option<PlannedActions>,
}

/// The planner node's state: messages in, plan requests out.
pub struct PlannerStep {
    settings: PlannerSettings,
    space: LatentSpace,
    timeline: Timeline,
    goal: Option<Goal>,
    last: Option<LastPlan>,
    seed: u64,
}

impl PlannerStep {
    /// A planner that has seen nothing.
    pub fn new(settings: PlannerSettings, timing: Timing, space: LatentSpace) -> Self {
        Self {
            settings,
            space,
            timeline: Timeline::new(timing, settings.context_frames),
            goal: None,
            last: None,
            seed: settings.seed,
        }
    }

    /// Takes a latent; [`Self::request`] then says whether to plan.
    ///
    /// # Errors
    /// [`PlannerError`]: the latent is left out.
    pub fn latent(&mut self, latent: &Latent) -> Result<Arrival, PlannerError> {
        let values: Arc<[f32]> = decode_latent(latent, &self.space)?.into();
        let arrival = self
            .timeline
            .frame(latent.header.stamp, &latent.header.frame_id, values)?;
        self.note(arrival);
        Ok(arrival)
    }

    /// Takes an action that was taken.
    ///
    /// # Errors
    /// [`PlannerError::Timeline`]: the action is left out.
    pub fn action(&mut self, action: &Action) -> Result<Arrival, PlannerError> {
        let arrival = self.timeline.action(action)?;
        self.note(arrival);
        Ok(arrival)
    }

    /// Takes the actions to come, which say what was done where an action itself is missing.
    ///
    /// # Errors
    /// [`PlannerError::Timeline`]: the chunk is left out.
    pub fn chunk(&mut self, chunk: &ActionChunk) -> Result<(), PlannerError> {
        Ok(self.timeline.chunk(chunk)?)
    }

    /// Takes a goal, row-major values of the planner's own latent space. The next plan starts anew.
    pub fn set_goal(&mut self, goal: Goal) {
        self.goal = Some(goal);
        self.last = None;
    }

    /// The plan to make now.
    ///
    /// # Errors
    /// [`PlanWait`] says what is missing.
    pub fn request(&mut self) -> Result<PlanRequest, PlanWait> {
        let goal = self.goal.clone().ok_or(PlanWait::NoGoal)?;
        let context = self.timeline.context()?;
        let observed_ns = context.frames.last().ok_or(Wait::NoFrame)?.stamp_ns;
        let timing = self.timeline.timing();
        let mut start = None;
        if let Some(last) = &self.last {
            // A stamp that is a jitter early is due all the same.
            let since_ns = observed_ns - last.observed_ns;
            if since_ns
                < self
                    .settings
                    .plan_period_ns
                    .saturating_sub(timing.tolerance_ns)
                    .max(1)
            {
                return Err(PlanWait::Recent);
            }
            start = last
                .actions
                .as_ref()
                .and_then(|actions| shifted(actions, since_ns, timing.step_ns()));
        }
        self.last = Some(LastPlan {
            observed_ns,
            actions: None,
        });
        let seed = self.seed;
        self.seed = self.seed.wrapping_add(1);
        Ok(PlanRequest {
            epoch: self.timeline.epoch(),
            base_frame: self.timeline.base_frame(),
            context,
            goal,
            start,
            seed,
            timing,
        })
    }

    /// Takes note of what a request led to: the start of the next search. False, and nothing is noted, where time has
    /// jumped, or the goal has changed, since: the plan is stale.
    #[must_use]
    pub fn planned(&mut self, request: &PlanRequest, actions: &PlannedActions) -> bool {
        if request.epoch != self.timeline.epoch() || self.goal.as_ref() != Some(&request.goal) {
            return false;
        }
        let observed_ns = request.context.frames.last().map(|frame| frame.stamp_ns);
        if let Some(last) = &mut self.last
            && Some(last.observed_ns) == observed_ns
        {
            last.actions = Some(actions.clone());
        }
        true
    }

    /// Forgets all history and the last plan, and takes a new seed where one is given. The goal stays: it is the user's.
    pub fn reset(&mut self, seed: Option<u64>) -> String {
        self.flush();
        if let Some(seed) = seed {
            self.seed = seed;
        }
        let goal = if self.goal.is_some() {
            "kept the goal"
        } else {
            "there is no goal"
        };
        format!(
            "forgot all frames, actions and the last plan; {goal}; seed {}",
            self.seed
        )
    }

    /// Forgets all history.
    fn flush(&mut self) {
        self.timeline.clear();
        self.last = None;
    }

    /// Takes note that the node's clock jumped back to `now`; whether that flushed the history.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        let has_flushed = self.timeline.clock_jumped(now);
        if has_flushed {
            self.last = None;
        }
        has_flushed
    }

    fn note(&mut self, arrival: Arrival) {
        if arrival.flushed {
            self.last = None;
        }
    }
}

/// A plan made `since_ns` ago, as the start of the next one; none where all its steps have passed.
fn shifted(plan: &PlannedActions, since_ns: i64, step_ns: i64) -> Option<Vec<Vec<f32>>> {
    let passed = usize::try_from((since_ns + step_ns / 2) / step_ns.max(1)).ok()?;
    if passed >= plan.actions.len() {
        return None;
    }
    let mut shifted = plan.clone();
    for _ in 0..passed {
        shifted.actions = shifted.shifted();
    }
    Some(shifted.actions)
}

#[cfg(test)]
mod tests;
