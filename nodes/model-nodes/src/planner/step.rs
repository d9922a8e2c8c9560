//! The planner's state.

use std::{
    convert::Infallible,
    sync::Arc,
    time::{Duration, Instant},
};

use thiserror::Error;
use wm_motion::{
    actions::{ActionSpace, Kind},
    motion::StepAction,
};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{Point, PoseStamped},
    wm_msgs::{Action, ActionChunk, Latent},
};
use wm_planner::{PlannedActions, Waypoint};

use super::{Goal, Planned};
use crate::{
    harness::follows,
    history::{Arrival, FROZEN_CAMERA, History, HistoryError, Moment, Reception, Wait},
};

/// Number of searches from which the next lead is estimated.
const RECENT: usize = 4;
/// Most model steps between observation and plan: predictions further ahead are poor.
const MOST_LEAD: usize = 16;

/// Settings of when and from what to plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlannerSettings {
    /// Least time between the observations of two plans for one goal \[ns\].
    pub plan_period_ns: i64,
    /// Greatest age of the newest frame, by when it was received, at which a plan is made or sent.
    pub max_age: Duration,
    /// When a plan begins.
    pub lead: Lead,
    /// Seed of the first plan; each later one adds 1, so that a plan does not repeat the candidates of the last.
    pub seed: u64,
    /// Whether a plan has to know where the end effector is.
    pub needs_pose: bool,
}

/// When a plan begins: the robot keeps moving during a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lead {
    /// When the search is expected to end, by the times of the last ones.
    Measured {
        /// Assumed time of the first search.
        first: Duration,
    },
    /// This many model steps after the observation.
    Steps(usize),
}

/// The inputs of a plan.
#[derive(Clone, Debug)]
pub struct PlanRequest {
    /// The observation.
    pub moment: Moment,
    /// The robot's actions until the plan begins, one per model step, and the one after them.
    pub until: Vec<StepAction>,
    /// The goal.
    pub goal: Arc<Goal>,
    /// When that was set, by the node's clock \[ns\].
    pub goal_set_ns: i64,
    /// How far along the goal's latents the plans before this one came.
    pub waypoint: Waypoint,
    /// Model steps between the observation of the plan before and this one; 0 for the first one.
    pub passed_steps: f32,
    /// Position of the end effector when the plan begins \[m\], in the frame of the actions; `None` if unknown.
    pub position: Option<[f64; 3]>,
    /// First mean of the search: the rest of the last plan for this goal.
    pub start: Option<PlannedActions>,
    /// Seed of the candidates and of the noise.
    pub seed: u64,
    /// Whether to make a picture of the plan's result.
    pub is_shown: bool,
    /// Whether to make pictures of the subgoals.
    pub shows_subgoals: bool,
    /// Whether to report the progress of the search.
    pub is_followed: bool,
}

impl PlanRequest {
    /// Model steps from the observation to the plan's first action.
    pub fn lead_steps(&self) -> usize {
        self.until.len().saturating_sub(1)
    }

    /// When the plan begins \[ns\].
    pub fn begin_ns(&self) -> i64 {
        let moment = &self.moment;
        moment
            .timing
            .step_at(moment.observed.stamp_ns, self.lead_steps())
    }
}

/// Why a plan is not sent.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Unsent {
    /// The goal or the history has changed.
    #[error("it was ready only after a new goal, a reset or a clock jump")]
    Superseded,
    /// The camera stopped during the search.
    #[error(transparent)]
    Frozen(Wait),
    /// No frame has arrived for long, so the robot's state is unknown.
    #[error(transparent)]
    Stale(Wait),
    /// Its last action would have ended.
    #[error(
        "it took {taken_s:.1} s, and its last action would be over: raise horizon, or lower deadline or population"
    )]
    Late {
        /// Since the observation was received \[s\].
        taken_s: f64,
    },
}

impl Unsent {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Superseded => "stale_plan",
            Self::Frozen(_) => FROZEN_CAMERA,
            Self::Stale(_) => "stale_frame",
            Self::Late { .. } => "late_plan",
        }
    }
}

/// Why no plan is made.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum PlanWait {
    /// No goal is set.
    #[error("no goal has arrived yet")]
    NoGoal,
    /// The history is not complete.
    #[error(transparent)]
    History(#[from] Wait),
    /// The camera has stopped.
    #[error("{}", Wait::Frozen)]
    Frozen {
        /// Whether a plan was due, which is dropped.
        is_due: bool,
    },
    /// A workspace is set, and no pose of the end effector has arrived.
    #[error(
        "no pose has arrived on ee_pose for {max_s} s, which workspace_min and workspace_max need"
    )]
    NoPose {
        /// `max_age` \[s\].
        max_s: f64,
    },
    /// The axes of the pose differ from those of the actions.
    #[error("the frame of ee_pose is {actual:?}; expected that of the actions, {expected:?}")]
    PoseFrame {
        /// Of the actions.
        expected: String,
        /// Of the pose.
        actual: String,
    },
    /// The last plan is younger than the plan period.
    #[error("the last plan is still recent")]
    Recent,
}

/// The last plan for the goal.
struct LastPlan {
    begin_ns: i64,
    actions: PlannedActions,
}

/// A goal and the progress towards it.
#[derive(Clone)]
struct SetGoal {
    goal: Arc<Goal>,
    set_ns: i64,
    waypoint: Waypoint,
}

/// The position of the end effector.
#[derive(Clone)]
struct Pose {
    frame_id: String,
    /// \[m\].
    position: [f64; 3],
    /// When it was received.
    at: Instant,
}

/// The planner node's state: messages in, plan requests out.
pub struct PlannerStep {
    settings: PlannerSettings,
    history: History,
    goal: Option<SetGoal>,
    /// The goal in the latents of the previous model, until it is read again.
    previous_goal: Option<SetGoal>,
    pose: Option<Pose>,
    /// Observation of the newest request for the goal \[ns\].
    requested_ns: Option<i64>,
    last: Option<LastPlan>,
    /// How long the last searches took, the newest last.
    searches: Vec<Duration>,
    seed: u64,
}

follows!(
    PlannerStep,
    (),
    |arrival| (arrival, ()),
    Infallible,
    |arrival| (arrival, None)
);

impl PlannerStep {
    /// A planner over an empty `history`.
    pub fn new(settings: PlannerSettings, history: History) -> Self {
        Self {
            settings,
            history,
            goal: None,
            previous_goal: None,
            pose: None,
            requested_ns: None,
            last: None,
            searches: Vec::new(),
            seed: settings.seed,
        }
    }

    /// Continues from the state of the model `before`. Returns whether its latents and actions are this model's; only then
    /// its goal is kept. If the goal is read again by this model, the progress towards it is kept too.
    pub fn continue_from(&mut self, before: &Self, now: Time) -> bool {
        let is_same = self.history.continue_from(&before.history, now);
        self.previous_goal.clone_from(&before.previous_goal);
        if is_same {
            self.goal.clone_from(&before.goal);
        } else if before.goal.is_some() {
            self.previous_goal.clone_from(&before.goal);
        }
        self.pose.clone_from(&before.pose);
        self.seed = before.seed;
        is_same
    }

    /// Takes a latent; [`Self::request`] then decides whether to plan.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn latent(
        &mut self,
        latent: &Latent,
        reception: Reception,
    ) -> Result<Arrival, HistoryError> {
        let arrival = self.history.latent(latent, reception)?;
        if arrival.flushed {
            self.forget_plans();
        }
        Ok(arrival)
    }

    /// Takes an action of the robot.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
        self.history.action(action, now)
    }

    /// Takes the actions to come.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn chunk(&mut self, chunk: &ActionChunk, now: Time) -> Result<Arrival, HistoryError> {
        self.history.chunk(chunk, now)
    }

    /// Takes the position of the end effector, received at `at`. Returns false, and drops it, if it is not finite.
    pub fn pose(&mut self, pose: &PoseStamped, at: Instant) -> bool {
        let Point { x, y, z } = pose.pose.position;
        let position = [x, y, z];
        let is_finite = position.iter().all(|value| value.is_finite());
        if is_finite {
            self.pose = Some(Pose {
                frame_id: pose.header.frame_id.clone(),
                position,
                at,
            });
        }
        is_finite
    }

    /// Takes a goal at `now`, with latents of the planner's own space. The next plan does not start from the last one.
    pub fn set_goal(&mut self, goal: Goal, now: Time) {
        let begun = self.previous_goal.take().filter(|previous| {
            let previous = &previous.goal;
            (previous.stamp, previous.latents.len()) == (goal.stamp, goal.latents.len())
        });
        let (set_ns, waypoint) = begun.map_or_else(
            || (now.to_nanos(), Waypoint::default()),
            |begun| (begun.set_ns, begun.waypoint),
        );
        self.goal = Some(SetGoal {
            goal: Arc::new(goal),
            set_ns,
            waypoint,
        });
        self.forget_plans();
    }

    /// Whether a goal is set.
    pub fn has_goal(&self) -> bool {
        self.goal.is_some()
    }

    /// The plan to make at `now`.
    ///
    /// # Errors
    /// [`PlanWait`] says what is missing.
    pub fn request(&mut self, now: Instant) -> Result<PlanRequest, PlanWait> {
        let set = self.goal.as_ref().ok_or(PlanWait::NoGoal)?;
        let moment = self.history.latest_moment()?;
        let observed_ns = moment.observed.stamp_ns;
        let fresh = moment.expect_fresh(now, self.settings.max_age);
        if fresh == Err(Wait::Frozen) {
            let is_due = self.is_due_at(observed_ns);
            if is_due {
                self.requested_ns = Some(observed_ns);
            }
            return Err(PlanWait::Frozen { is_due });
        }
        let is_said = fresh.is_err() && !self.history.is_between_contexts();
        if !self.is_due_at(observed_ns) && !is_said {
            return Err(PlanWait::Recent);
        }
        fresh?;
        let lead_steps = self.lead_steps(&moment, now);
        let until = self.history.future_from(observed_ns, lead_steps + 1)?;
        let passed_ns = self
            .requested_ns
            .map_or(0, |before_ns| observed_ns - before_ns);
        let mut request = PlanRequest {
            // A ratio of seconds.
            passed_steps: passed_ns as f32 / moment.timing.step_ns() as f32,
            position: match self.position_after(&until, &moment.base_frame, now) {
                Err(wait) if self.settings.needs_pose => return Err(wait),
                position => position.ok(),
            },
            moment,
            until,
            goal: Arc::clone(&set.goal),
            goal_set_ns: set.set_ns,
            waypoint: set.waypoint,
            start: None,
            seed: self.seed,
            is_shown: false,
            shows_subgoals: false,
            is_followed: false,
        };
        request.start = self.last.as_ref().and_then(|last| {
            let step_ns = request.moment.timing.step_ns();
            let since_ns = request.begin_ns() - last.begin_ns;
            let passed = usize::try_from((since_ns + step_ns / 2) / step_ns.max(1)).ok()?;
            last.actions.without(passed)
        });
        self.requested_ns = Some(observed_ns);
        self.seed = self.seed.wrapping_add(1);
        Ok(request)
    }

    /// What the values of actions are.
    pub fn action_space(&self) -> &ActionSpace {
        self.history.encoding().space()
    }

    /// Clears the goal: no plans until the next one.
    pub fn clear_goal(&mut self) {
        self.goal = None;
        self.previous_goal = None;
        self.forget_plans();
    }

    /// Whether the goal of a request is still the goal.
    pub fn is_current(&self, request: &PlanRequest) -> bool {
        let goal = self.goal.as_ref();
        goal.is_some_and(|set| Arc::ptr_eq(&set.goal, &request.goal))
    }

    /// Whether the newest frame is newer than that of the last request by the plan period.
    pub fn is_due(&self) -> bool {
        let newest = self.history.newest();
        newest.is_none_or(|newest| self.is_due_at(newest.stamp_ns))
    }

    fn is_due_at(&self, stamp_ns: i64) -> bool {
        let Some(requested_ns) = self.requested_ns else {
            return true;
        };
        // A stamp that is slightly early is due.
        let due_ns = self.settings.plan_period_ns - self.history.timing().tolerance_ns;
        stamp_ns - requested_ns >= due_ns.max(1)
    }

    /// Position of the end effector after all but the last of the steps `until` a plan begins.
    fn position_after(
        &self,
        until: &[StepAction],
        frame_id: &str,
        now: Instant,
    ) -> Result<[f64; 3], PlanWait> {
        let max_age = self.settings.max_age;
        let age = |pose: &Pose| now.saturating_duration_since(pose.at);
        let Some(pose) = self.pose.as_ref().filter(|pose| age(pose) <= max_age) else {
            let max_s = max_age.as_secs_f64();
            return Err(PlanWait::NoPose { max_s });
        };
        if pose.frame_id != frame_id {
            return Err(PlanWait::PoseFrame {
                expected: frame_id.to_owned(),
                actual: pose.frame_id.clone(),
            });
        }
        let mut position = pose.position;
        let kinds = || self.history.encoding().space().dimensions();
        let before = until.split_last().map_or(&[][..], |(_, before)| before);
        for interval in before.iter().flat_map(|step| &step.intervals) {
            let moved = interval.values.iter().zip(kinds());
            let moved = moved.filter(|(_, dimension)| dimension.kind == Kind::TranslationDelta);
            for (axis, (value, _)) in position.iter_mut().zip(moved) {
                *axis += f64::from(*value);
            }
        }
        Ok(position)
    }

    /// Model steps in which the search will be over.
    fn lead_steps(&self, moment: &Moment, now: Instant) -> usize {
        let search = match self.settings.lead {
            Lead::Steps(steps) => return steps.min(MOST_LEAD),
            Lead::Measured { first } => self.searches.iter().max().copied().unwrap_or(first),
        };
        let age = now.saturating_duration_since(moment.observed.reception.at);
        let step = Duration::from_nanos(moment.timing.step_ns().unsigned_abs());
        let steps = (age + search).as_secs_f64() / step.as_secs_f64().max(1e-9);
        // The nearest one: a plan that begins a whole step late for a search of a moment is further from the truth than
        // one whose first moment is over. A handful; a cast saturates.
        (steps.round() as usize).min(MOST_LEAD)
    }

    /// Records the result of a request and its time `taken`: the start of the next search, and its lead.
    ///
    /// # Errors
    /// [`Unsent`] says why the plan must not be sent at `now`.
    pub fn planned(
        &mut self,
        request: &PlanRequest,
        planned: &Planned,
        taken: Duration,
        now: Instant,
    ) -> Result<(), Unsent> {
        if self.searches.len() == RECENT {
            self.searches.remove(0);
        }
        self.searches.push(taken);
        let moment = &request.moment;
        let goal = self
            .goal
            .as_mut()
            .filter(|set| Arc::ptr_eq(&set.goal, &request.goal));
        let Some(set) = goal.filter(|_| moment.epoch == self.history.epoch()) else {
            return Err(Unsent::Superseded);
        };
        set.waypoint = planned.waypoint;
        let actions = &planned.actions;
        self.last = Some(LastPlan {
            begin_ns: request.begin_ns(),
            actions: actions.clone(),
        });
        if self.history.is_frozen() {
            return Err(Unsent::Frozen(Wait::Frozen));
        }
        if let Some(newest) = self.history.newest() {
            let age = now.saturating_duration_since(newest.reception.at);
            if age > self.settings.max_age {
                return Err(Unsent::Stale(Wait::Stale {
                    age_s: age.as_secs_f64(),
                    max_s: self.settings.max_age.as_secs_f64(),
                }));
            }
        }
        let since = now.saturating_duration_since(moment.observed.reception.at);
        let end_ns = moment
            .timing
            .step_at(request.begin_ns(), actions.actions.len());
        let left_ns = end_ns - moment.observed.stamp_ns;
        if since.as_nanos() > u128::from(left_ns.unsigned_abs()) {
            return Err(Unsent::Late {
                taken_s: since.as_secs_f64(),
            });
        }
        Ok(())
    }

    /// Clears the history and the last plan, and takes a new seed if one is given. The user's goal stays, from its beginning.
    pub fn reset(&mut self, seed: Option<u64>, now: Time) -> String {
        self.history.reset(now);
        self.forget_plans();
        if let Some(set) = &mut self.goal {
            set.waypoint = Waypoint::default();
            set.set_ns = now.to_nanos();
        }
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

    /// Handles a jump of the node's clock back to `now`; returns whether the history was flushed.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        let has_flushed = self.history.clock_jumped(now);
        if has_flushed {
            self.forget_plans();
        }
        has_flushed
    }

    fn forget_plans(&mut self) {
        self.requested_ns = None;
        self.last = None;
    }
}

#[cfg(test)]
mod tests;
