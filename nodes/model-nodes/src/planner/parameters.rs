//! The planner's parameters.

use std::time::Duration;

use anyhow::{Result, bail, ensure};
use wm_planner::{
    Arrival, CemSettings, IcemSettings, InverseSettings, MppiSettings, Path, PlannerChoice,
    PlannerSettings as Planners, Returned, Weights,
};
use wm_wire::transport::Transports;

use super::{Lead, MotionLimits, PlannerSettings, PlannerSetup, WorkspaceBox};
use crate::chunk_merging::Merging;

/// Largest accepted population, iteration count and so on: far beyond use, within every integer type.
const MANY: i64 = 1_000_000;
/// Assumed time of the first search if there is no deadline.
const FIRST_SEARCH: Duration = Duration::from_secs(1);

/// A planner by name; `None` for auto.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Named(Option<PlannerChoice>);

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// Image transport of the goal image and of the picture of what a plan leads to.
        pub(super) image_transport: Transports = "both";
        /// The planner: cem, icem, mppi, idm (what the inverse dynamics model tells), or one of the first three from what
        /// that tells, as idm+icem. subgoals+idm and subgoals+icem do so along subgoals, which the model proposes. auto: idm+icem if the model has an inverse dynamics model, else icem.
        planner: Named = "auto", one_of {
            "auto" => Named(None),
            "cem" => Named(Some(PlannerChoice::Cem)),
            "icem" => Named(Some(PlannerChoice::Icem)),
            "mppi" => Named(Some(PlannerChoice::Mppi)),
            "idm" => Named(Some(PlannerChoice::Idm)),
            "idm+cem" => Named(Some(PlannerChoice::IdmCem)),
            "idm+icem" => Named(Some(PlannerChoice::IdmIcem)),
            "idm+mppi" => Named(Some(PlannerChoice::IdmMppi)),
            "subgoals+idm" => Named(Some(PlannerChoice::SubgoalsIdm)),
            "subgoals+icem" => Named(Some(PlannerChoice::SubgoalsIcem)),
        };
        /// Candidates per iteration; in icem of the first one, with fewer in each later one.
        population: usize = 16, in 2..=MANY;
        /// Iterations per plan.
        iterations: usize = 2, in 1..=MANY;
        /// Number of best candidates that the next iteration is fitted to (cem, icem).
        elites: usize = 4, in 2..=MANY;
        /// Number of model steps in a plan.
        horizon: usize = 2, in 1..=16;
        /// Candidates per batch. The deadline is checked after each batch.
        batch: usize = 16, in 1..=MANY;
        /// Initial standard deviation, as a fraction of each dimension's range.
        initial_std: f64 = 0.15, in 1e-6..=10.0;
        /// Minimum standard deviation [model units] (cem, icem).
        std_floor: f64 = 0.02, in 1e-9..=10.0;
        /// Which actions are returned (cem).
        returned: Returned = "best_seen", one_of {
            "best_seen" => Returned::BestSeen, "final_mean" => Returned::FinalMean,
        };
        /// Exponent of the noise's spectrum over time: 0 is white, larger is smoother (icem).
        noise_beta: f64 = 2.0, in 0.0..=10.0;
        /// Temperature, as a fraction of the standard deviation of the costs (mppi).
        temperature: f64 = 0.3, in 1e-6..=1e6;
        /// The latents that the inverse dynamics model is asked about: the imagined ones on the way, or a straight line.
        idm_path: Path = "imagined", one_of { "imagined" => Path::Imagined, "line" => Path::Line };
        /// Weight of the distance to the goal after the last step.
        goal_weight: f64 = 1.0, in 0.0..=1e6;
        /// Weight of the mean distance to the goal over all steps; of several goals, to that of each step.
        path_weight: f64 = 0.0, in 0.0..=1e6;
        /// Weight of the size of the actions.
        action_weight: f64 = 0.0, in 0.0..=1e6;
        /// Weight of the change from one action to the next.
        smoothness_weight: f64 = 0.0, in 0.0..=1e6;
        /// Weight of the improbability of success, by the model's success probe, for goals with an instruction.
        success_weight: f64 = 0.0, in 0.0..=1e6;
        /// Weight of the model steps that remain from the plan's end to the goal, by the model's learnt distance.
        steps_weight: f64 = 0.0, in 0.0..=1e6;
        /// Euler steps with which subgoals are sampled by the plan's seed; 1: the expected subgoals.
        subgoal_steps: usize = 1, in 1..=100;
        /// Of several goals, one is reached when its distance is below this share of that to the next one.
        goal_arrival: f64 = 0.3, in 0.0..=1.0;
        /// Of several goals, for how long one is tried before the next one is [s].
        goal_patience: f64 = 1.6, in 0.0..=3600.0;
        /// Number of other noise seeds that the plan's cost is predicted with, for its spread.
        spread_seeds: usize = 0, in 0..=64;
        /// Number of observed frames that a plan starts from, one model step apart; at most 64.
        pub(super) context_frames: usize = 2, in 1..=MANY;
        /// Minimum time between two plans for one goal [s].
        pub(super) plan_period: f64 = 2.0, in 0.0..=3600.0;
        /// Seed of the candidates and the noise of the first plan; each later plan adds 1.
        seed: i64 = 0;
        /// Euler steps per predicted frame; 0: the model's own number.
        integration_steps: usize = 0, in 0..=MANY;
        /// Names of the action dimensions to search; empty: all except grippers, which hold their state.
        search: Vec<String> = Vec::<String>::new();
        /// Maximum time since the newest frame was received [s]. After that, no plan is made or sent.
        max_age: Duration = 2.0, in 0.01..=3600.0;
        /// Model steps from the observed frame to the first planned action. The robot's motion in between is predicted.
        /// -1: as many as the last searches took, to the nearest.
        lead_steps: i64 = -1, in -1..=16;
        /// How overlapping action chunks are merged; weighted: 0.3 of the older and 0.7 of the newer chunk.
        pub(super) chunk_merging: Merging = "latest";
        /// Maximum translation per dimension in one model step [m]; 0: the model's own bound.
        max_translation: f64 = 0.0, in 0.0..=10.0;
        /// Maximum rotation per dimension in one model step [rad]; 0: the model's own bound.
        max_rotation: f64 = 0.0, in 0.0..=10.0;
        /// Maximum change of the translation along each axis from one model step to the next [m]; 0: no limit.
        max_translation_change: f64 = 0.0, in 0.0..=10.0;
        /// Maximum change of the rotation about each axis from one model step to the next [rad]; 0: no limit.
        max_rotation_change: f64 = 0.0, in 0.0..=10.0;
        /// Lower corner of the box that the end effector is kept within [m]: x, y, z in the frame of the actions. Empty:
        /// no box. With one, ee_pose is needed.
        workspace_min: Vec<f64> = Vec::<f64>::new();
        /// Upper corner of that box [m]: x, y, z.
        workspace_max: Vec<f64> = Vec::<f64>::new();
        /// Where the cost of being near a side of the box begins [m].
        workspace_margin: f64 = 0.05, in 1e-4..=10.0;
        /// Weight of that cost.
        workspace_weight: f64 = 0.0, in 0.0..=1e6;
        /// Time from one camera frame to the next [s]; 0: as in the model's training.
        pub(super) frame_period: f64 = 0.0, in 0.0..=60.0;
        /// Maximum duration of a search [s]; 0: no limit.
        pub(super) deadline: Duration = 1.5, in 0.0..=3600.0;
        /// Zenoh endpoints of planner workers, such as tcp/desk.local:7447, which cost candidates too; empty: none. They
        /// can help where population is more than batch. Needs a program built with the feature workers.
        pub(super) workers: Vec<String> = Vec::<String>::new();
        /// Zenoh configuration file for reaching them (TLS, access control); empty: none.
        pub(super) workers_config: String = "";
        /// Added to the nice value of the computing threads, as with nice(1). Above 0, other nodes and programs go
        /// first: a plan may be later than a prediction.
        pub(super) nice: i32 = 15, in 0..=19;
    }
}

impl Parameters {
    /// The planner's setup, for model steps of `step_s`.
    pub(super) fn setup(&self, step_s: f64) -> Result<PlannerSetup> {
        let (population, iterations, elites) = (self.population, self.iterations, self.elites);
        let (initial_std, std_floor) = (self.initial_std as f32, self.std_floor as f32);
        Ok(PlannerSetup {
            choice: self.planner.0,
            settings: Planners {
                cem: CemSettings {
                    population,
                    iterations,
                    elites,
                    initial_std,
                    std_floor,
                    try_proposals: true,
                    returned: self.returned,
                },
                icem: IcemSettings {
                    population,
                    iterations,
                    elites,
                    initial_std,
                    std_floor,
                    noise_beta: self.noise_beta as f32,
                    ..IcemSettings::default()
                },
                mppi: MppiSettings {
                    population,
                    iterations,
                    std: initial_std,
                    temperature: self.temperature as f32,
                },
                idm: InverseSettings {
                    path: self.idm_path,
                },
            },
            horizon: self.horizon,
            batch: self.batch,
            weights: Weights {
                goal: self.goal_weight as f32,
                path: self.path_weight as f32,
                action: self.action_weight as f32,
                smoothness: self.smoothness_weight as f32,
            },
            success: self.success_weight as f32,
            steps_to_goal: self.steps_weight as f32,
            subgoal_steps: self.subgoal_steps,
            spread_seeds: self.spread_seeds,
            arrival: Arrival {
                share: self.goal_arrival as f32,
                steps: (self.goal_patience / step_s) as f32,
            },
            integration_steps: Some(self.integration_steps).filter(|steps| *steps > 0),
            search: self.search.clone(),
            limits: MotionLimits {
                translation: positive(self.max_translation),
                rotation: positive(self.max_rotation),
                translation_change: positive(self.max_translation_change),
                rotation_change: positive(self.max_rotation_change),
                workspace: self.workspace()?,
            },
        })
    }

    pub(super) fn workspace(&self) -> Result<Option<WorkspaceBox>> {
        let (min, max) = match (&self.workspace_min[..], &self.workspace_max[..]) {
            ([], []) => return Ok(None),
            ([ax, ay, az], [bx, by, bz]) => ([*ax, *ay, *az], [*bx, *by, *bz]),
            (min, max) => bail!(
                "workspace_min has {} numbers and workspace_max has {}; expected x, y and z in both, or none",
                min.len(),
                max.len()
            ),
        };
        for (axis, (min, max)) in ["x", "y", "z"].into_iter().zip(min.into_iter().zip(max)) {
            ensure!(
                min.is_finite() && max.is_finite() && min < max,
                "the workspace box goes from {min} to {max} along {axis}: expected finite numbers, the lower one first"
            );
        }
        Ok(Some(WorkspaceBox {
            min,
            max,
            margin: self.workspace_margin,
            weight: self.workspace_weight as f32,
        }))
    }

    /// Settings of the state.
    pub(super) fn settings(&self) -> PlannerSettings {
        PlannerSettings {
            max_age: self.max_age,
            lead: match usize::try_from(self.lead_steps) {
                Ok(steps) => Lead::Steps(steps),
                Err(_) => Lead::Measured {
                    first: Some(self.deadline)
                        .filter(|deadline| !deadline.is_zero())
                        .unwrap_or(FIRST_SEARCH),
                },
            },
            // The range keeps it within an hour.
            plan_period_ns: (self.plan_period * 1e9) as i64,
            // Any 64 bits are a seed.
            seed: self.seed as u64,
            needs_pose: !self.workspace_min.is_empty(),
        }
    }
}

/// A limit; `None` for 0.
fn positive(limit: f64) -> Option<f64> {
    Some(limit).filter(|limit| *limit > 0.0)
}
