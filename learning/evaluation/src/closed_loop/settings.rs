//! Settings of a closed loop.

use anyhow::{Result, ensure};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use wm_planner::{PlannerChoice, PlannerSettings};
use wm_sim::GoalKind;

use super::controller::Controller;
use crate::settings::changed;

/// Pictures of the solution given to a planner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Goals {
    /// The last one only.
    #[default]
    Final,
    /// One per model step, in order.
    Subgoals,
}

/// Settings of a closed loop; a YAML file may hold any of them by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosedLoopSettings {
    /// Model steps of a plan.
    pub horizon: usize,
    /// Executed model steps of each plan.
    pub execute: usize,
    /// Most model steps of an episode, as a multiple of the oracle's; at least ten.
    pub patience: f64,
    /// Pictures given to the planner.
    pub goals: Goals,
    /// A subgoal is reached when its latent distance is below this share of its distance to the next subgoal.
    pub arrival: f32,
    /// Model steps after which the next subgoal is tried anyway.
    pub wait: usize,
    /// Whether to search the gripper; otherwise it keeps its state.
    pub gripper: bool,
    /// Time limit of a plan \[ms\]; 0 for none, which makes actions deterministic.
    pub deadline_ms: u64,
    /// Candidates rolled out at once.
    pub batch: usize,
    /// Weight of the distance to the goal after the last step.
    pub last_step: f32,
    /// Weight of the mean distance to the goal over all steps.
    pub all_steps: f32,
    /// Weight of the size of the actions.
    pub action: f32,
    /// Weight of the change from one action to the next.
    pub smoothness: f32,
    /// Weight of the model steps that remain from the plan's end to the goal, by the model's learnt distance.
    pub steps_to_goal: f32,
    /// Euler steps with which subgoals are sampled; 1 for the expected ones.
    pub subgoal_steps: usize,
    /// Settings of the planners.
    pub planner: PlannerSettings,
}

impl ClosedLoopSettings {
    /// Defaults for a task and a controller. To move an object, the gripper is searched, and the planner gets subgoals,
    /// since the last picture alone does not show the path, unless it makes subgoals itself. A search
    /// plans one model step, with [`PlannerSettings::quick`].
    pub fn of(task: GoalKind, controller: Controller) -> Self {
        let moves_object = task != GoalKind::Reach;
        let shows_way =
            matches!(controller, Controller::Planner(choice) if choice.needs_subgoals());
        let default = Self::default();
        let (horizon, planner) = match controller {
            Controller::Planner(PlannerChoice::Idm) => (4, default.planner),
            Controller::Planner(PlannerChoice::SubgoalsIdm) => (1, default.planner),
            Controller::Planner(search) => (1, PlannerSettings::quick(search)),
            _ => (default.horizon, default.planner),
        };
        Self {
            horizon,
            planner,
            goals: if moves_object && !shows_way {
                Goals::Subgoals
            } else {
                Goals::Final
            },
            gripper: moves_object,
            ..Self::default()
        }
    }
}

impl ClosedLoopSettings {
    /// Applies the settings of a YAML text.
    ///
    /// # Errors
    /// Names an unknown setting.
    pub fn with(&self, text: &str) -> Result<Self> {
        changed(self, text)
    }

    /// Checks the numbers, except those of the planner.
    ///
    /// # Errors
    /// Names the first invalid number.
    pub fn validate(&self) -> Result<()> {
        ensure!(
            (1..=16).contains(&self.horizon) && (1..=self.horizon).contains(&self.execute),
            "horizon must be from 1 to 16 and execute from 1 to horizon, not {} and {}",
            self.horizon,
            self.execute
        );
        ensure!(
            self.patience.is_finite() && self.patience > 0.0,
            "patience must be positive and finite, not {}",
            self.patience
        );
        ensure!(self.batch > 0, "batch must be at least 1");
        ensure!(
            self.steps_to_goal.is_finite() && self.steps_to_goal >= 0.0,
            "steps_to_goal must be finite and at least 0, not {}",
            self.steps_to_goal
        );
        ensure!(self.subgoal_steps > 0, "subgoal_steps must be at least 1");
        Ok(())
    }
}

impl Default for ClosedLoopSettings {
    fn default() -> Self {
        Self {
            horizon: 4,
            execute: 1,
            patience: 5.0,
            goals: Goals::Final,
            arrival: 0.3,
            wait: 4,
            gripper: false,
            deadline_ms: 0,
            batch: 16,
            last_step: 0.5,
            all_steps: 0.5,
            action: 0.0,
            smoothness: 0.0,
            steps_to_goal: 0.0,
            subgoal_steps: 1,
            planner: PlannerSettings::default(),
        }
    }
}
