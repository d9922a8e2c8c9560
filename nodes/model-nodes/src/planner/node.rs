//! The planner on the wire.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use wm_camera::image_message::{encode_image, encode_jpeg};
use wm_motion::actions::ActionEncoding;
use wm_msgs::{
    builtin_interfaces::{Duration as RosDuration, Time},
    geometry_msgs::PoseStamped,
    wm_msgs::Plan,
};
use wm_planner::{
    Arrival, CemSettings, IcemSettings, InverseSettings, MppiSettings, Path, PlannerChoice,
    PlannerSettings as Planners, Returned, Weights,
};
use wm_ros::{
    Diagnostics, Node, NodeDefinition, Publisher, Qos, Subscription, complaints::Complaints,
};
use wm_zoo::{ModelFolder, success_probe::SuccessClassifier};

use super::{
    GoalReader, Lead, MotionLimits, PlanRequest, PlanWait, Planned, PlannerError, PlannerModel,
    PlannerParts, PlannerSettings, PlannerSetup, PlannerStep, WorkspaceBox,
};
use crate::{
    chunk_merging::Merging,
    encoder::EncoderStep,
    harness::{self, Configured, Follower, GoalInputs, Goals, Inputs, ModelNode, Told},
    history::{History, HistorySettings, Timing, Wait, seconds},
    pool::Pool,
    work::{Stop, Work},
};
use wm_wire::{
    latent_message::LatentDtype,
    transport::{ImagePublisher, Pictures, Transports},
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Planner>();

/// Largest population, iteration count and the like that is accepted: far beyond use, within every integer type.
const MANY: i64 = 1_000_000;
/// Of the picture of what a plan leads to.
const JPEG_QUALITY: u8 = 90;
/// How long the first search is taken to be where there is no deadline.
const FIRST_SEARCH: Duration = Duration::from_secs(1);

/// The node itself, in a process that may run other nodes too.
///
/// # Errors
/// Parameters are invalid, weights cannot be loaded, or the graph fails.
pub async fn body(node: Node) -> Result<()> {
    harness::body::<Planner>(node).await
}

/// A planner by name; `None` for auto.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Named(Option<PlannerChoice>);

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Image transport of the goal image and of the picture of what a plan leads to.
        image_transport: Transports = "both";
        /// The planner: cem, icem, mppi, idm (what the inverse dynamics model tells), or one of the first three from what
        /// that tells, as idm+icem. auto: idm+icem if the model has an inverse dynamics model, else icem.
        planner: Named = "auto", one_of {
            "auto" => Named(None),
            "cem" => Named(Some(PlannerChoice::Cem)),
            "icem" => Named(Some(PlannerChoice::Icem)),
            "mppi" => Named(Some(PlannerChoice::Mppi)),
            "idm" => Named(Some(PlannerChoice::Idm)),
            "idm+cem" => Named(Some(PlannerChoice::IdmCem)),
            "idm+icem" => Named(Some(PlannerChoice::IdmIcem)),
            "idm+mppi" => Named(Some(PlannerChoice::IdmMppi)),
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
        /// Of several goals, one is reached when its distance is below this share of that to the next one.
        goal_arrival: f64 = 0.3, in 0.0..=1.0;
        /// Of several goals, how many plans are made for one before the next one is tried.
        goal_plans: usize = 4, in 1..=MANY;
        /// Number of other noise seeds that the plan's cost is predicted with, for its spread.
        spread_seeds: usize = 0, in 0..=64;
        /// Number of observed frames that a plan starts from, one model step apart; at most 64.
        context_frames: usize = 2, in 1..=MANY;
        /// Minimum time between two plans for one goal [s].
        plan_period: f64 = 2.0, in 0.0..=3600.0;
        /// Seed of the candidates and the noise of the first plan; each later plan adds 1.
        seed: i64 = 0;
        /// Euler steps per predicted frame; 0: the model's own number.
        integration_steps: usize = 0, in 0..=MANY;
        /// Names of the action dimensions to search; empty: all except grippers, which hold their state.
        search: Vec<String> = Vec::<String>::new();
        /// Maximum time since the newest frame was received [s]. After that, no plan is made or sent.
        max_age: Duration = 2.0, in 0.01..=3600.0;
        /// Model steps from the observed frame to the first planned action. The robot's motion in between is predicted.
        /// -1: as many as the last searches took.
        lead_steps: i64 = -1, in -1..=16;
        /// How overlapping action chunks are merged; weighted: 0.3 of the older and 0.7 of the newer chunk.
        chunk_merging: Merging = "latest";
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
        /// Time from one camera frame to the next [s], as in the model's training.
        frame_period: f64 = 0.2, in 1e-3..=60.0;
        /// Maximum duration of a search [s]; 0: no limit.
        deadline: Duration = 1.5, in 0.0..=3600.0;
        /// Added to the nice value of the computing threads, as with nice(1). Above 0, other nodes and programs go
        /// first: a plan may be later than a prediction.
        nice: i32 = 15, in 0..=19;
    }
}

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// Inputs about the robot.
        inputs: Inputs;
        /// What says what to reach.
        goals: GoalInputs;
        /// Where the end effector is, for the workspace box.
        poses: Subscription<PoseStamped> = "ee_pose", qos(Qos::best_effort(1));
        /// The best actions found.
        plans: Publisher<Plan> = "plan", qos(Qos::reliable(10));
        /// What the camera would see after the last of them, stamped with that time. Made while somebody subscribes.
        outcomes: ImagePublisher = "plan/image", qos(Qos::reliable(4));
    }
}

impl Parameters {
    /// How to plan.
    fn setup(&self) -> Result<PlannerSetup> {
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
            spread_seeds: self.spread_seeds,
            arrival: Arrival {
                share: self.goal_arrival as f32,
                plans: self.goal_plans,
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

    fn workspace(&self) -> Result<Option<WorkspaceBox>> {
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
    fn settings(&self) -> PlannerSettings {
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

/// A limit, where 0 says that there is none.
fn positive(limit: f64) -> Option<f64> {
    Some(limit).filter(|limit| *limit > 0.0)
}

/// What the node loads.
struct Model {
    encoder: Arc<Mutex<EncoderStep>>,
    planner: Arc<PlannerModel>,
    /// None: the model has none, or words do not count.
    probe: Option<Arc<SuccessClassifier>>,
    history: HistorySettings,
    space: wm_model::LatentSpace,
    encoding: ActionEncoding,
    pool: Pool,
}

/// What came of a search, and how long it took.
struct Finished {
    request: PlanRequest,
    planned: Result<Planned, PlannerError>,
    pictures: Option<Pictures>,
    taken: Duration,
}

struct Planner {
    follower: Follower,
    step: PlannerStep,
    goals: Goals,
    searches: Work<PlanRequest, Finished>,
    is_searching: bool,
    /// Whether plans are to be made as often as can be.
    is_eager: bool,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl ModelNode for Planner {
    const NAME: &'static str = "planner";
    const ABOUT: &'static str = "Plans actions that lead to a goal.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;

    fn check(parameters: &Parameters) -> Result<()> {
        parameters.workspace().map(|_| ())
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let (encoder, model) = (folder.encoder()?, folder.world_model()?);
        let history = HistorySettings {
            timing: Timing::of_camera(parameters.frame_period, &model.encoding),
            context_frames: parameters.context_frames.min(64),
            merging: parameters.chunk_merging.0,
        };
        let (space, encoding) = (model.space.clone(), model.encoding.clone());
        let name = model.name.clone();
        let setup = parameters.setup()?;
        let probe = match setup.success > 0.0 {
            true => folder.probe()?.map(Arc::new),
            false => None,
        };
        let parts = PlannerParts {
            model,
            idm: folder.idm()?.map(Arc::new),
            probe: probe.clone(),
            decoder: folder
                .decoder()?
                .map(|decoder| Arc::new(Mutex::new(decoder))),
        };
        let planner = PlannerModel::new(parts, setup)?;
        let choice = planner.choice();
        tracing::info!("planning with {name} by {choice} in latent space {space}");
        let encoder = EncoderStep::new(encoder, LatentDtype::F32);
        Ok(Model {
            encoder: Arc::new(Mutex::new(encoder)),
            planner: Arc::new(planner),
            probe,
            history,
            space,
            encoding,
            pool: Pool::new(Self::NAME, parameters.nice)?,
        })
    }

    fn activate(at: &Configured<Self>) -> Result<Self> {
        let (node, model) = (&at.node, &at.model);
        let (deadline, planner) = (at.parameters.deadline, Arc::clone(&model.planner));
        let transports = at.parameters.image_transport;
        let searches = Work::new(1, move |request: PlanRequest, stop: &Stop| {
            let started = Instant::now();
            let is_late = || !deadline.is_zero() && started.elapsed() >= deadline;
            let planned = planner.plan(&request, &mut |_| stop.is_asked() || is_late());
            let taken = started.elapsed();
            let pictures = planned
                .as_ref()
                .ok()
                .and_then(|planned| pictures(planned, transports));
            Finished {
                request,
                planned,
                pictures,
                taken,
            }
        })
        .on(&model.pool);
        let (space, encoding) = (model.space.clone(), model.encoding.clone());
        let history = History::new(model.history, space, encoding, node.now());
        let reader = GoalReader::new(&model.encoder).with_probe(model.probe.clone());
        Ok(Self {
            follower: Follower::new(node, &at.endpoints.inputs, "start the encoder"),
            step: PlannerStep::new(at.parameters.settings(), history),
            goals: Goals::new(reader, &model.pool),
            searches,
            is_searching: false,
            is_eager: at.parameters.plan_period == 0.0,
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
        })
    }

    async fn run(&mut self, at: &mut Configured<Self>) -> Result<()> {
        let Endpoints {
            inputs,
            goals,
            poses,
            plans,
            outcomes,
        } = &mut at.endpoints;
        loop {
            tokio::select! {
                biased;
                finished = self.searches.finished() => {
                    self.is_searching = false;
                    self.planned(finished.context("the planner's thread")?, plans, outcomes)?;
                    self.plan(outcomes);
                }
                goal = self.goals.next(goals, &mut self.complaints) => {
                    let Some(goal) = goal? else { return Ok(()) };
                    self.step.set_goal(goal, at.node.now());
                    self.plan(outcomes);
                }
                Some(pose) = poses.recv() => {
                    let at = pose.message.pose.position;
                    if !self.step.pose([at.x, at.y, at.z], Instant::now()) {
                        self.complaints.left_out("bad_pose", &"ee_pose: a position that is not finite");
                    }
                }
                event = self.follower.next(inputs) => {
                    let Some(event) = event else { return Ok(()) };
                    if let Some(Told::Seen(())) = self.follower.tell(event, &mut self.step, &mut self.complaints) {
                        self.plan(outcomes);
                    }
                }
            }
        }
    }
}

/// The pictures of what a plan leads to, where there is one.
fn pictures(planned: &Planned, transports: Transports) -> Option<Pictures> {
    let outcome = planned.outcome.as_ref()?;
    let message = &planned.message;
    let mut header = message.header.clone();
    if let Some(last) = message.actions.last() {
        let end_ns = last
            .header
            .stamp
            .to_nanos()
            .saturating_add(message.period.to_nanos());
        header.stamp = Time::from_nanos(end_ns);
    }
    let raw = transports
        .raw
        .then(|| encode_image(outcome, header.clone()));
    let jpeg = transports
        .compressed
        .then(|| encode_jpeg(outcome, header, JPEG_QUALITY));
    // A picture that the decoder made has a size that JPEG takes.
    let compressed = jpeg.and_then(Result::ok);
    Some(Pictures { raw, compressed })
}

impl Planner {
    /// Starts a search where one is due, or says what it waits for.
    fn plan(&mut self, outcomes: &ImagePublisher) {
        if self.is_searching {
            // The next search starts from the newest frame when this one is over.
            if !self.is_eager && self.step.is_due() {
                self.complaints
                    .left_out("overload", &"planning takes longer than plan_period");
            }
            return;
        }
        match self.step.request(Instant::now()) {
            Ok(mut request) => {
                request.is_shown = outcomes.subscribers() > 0;
                self.complaints.working("planning");
                self.is_searching = true;
                // None waits, so that none is given back.
                let _ = self.searches.submit(request);
            }
            Err(PlanWait::Recent) => self.complaints.working("planning"),
            Err(wait @ PlanWait::NoGoal) => self.complaints.waiting("goal", true, &wait),
            Err(wait @ PlanWait::NoPose { .. }) => self.complaints.waiting("pose", false, &wait),
            Err(PlanWait::History(wait @ Wait::NoFrame)) => {
                self.complaints.waiting(
                    "frame",
                    false,
                    &format_args!("a goal is set, but {wait} on latent"),
                );
            }
            Err(wait @ PlanWait::History(Wait::Context { .. })) => {
                self.complaints.waiting("context", true, &wait);
            }
            Err(wait) => self.complaints.waiting("history", false, &wait),
        }
    }

    fn planned(
        &mut self,
        finished: Finished,
        plans: &Publisher<Plan>,
        outcomes: &ImagePublisher,
    ) -> Result<()> {
        let Finished {
            request,
            planned,
            pictures,
            taken,
        } = finished;
        let planned = match planned {
            Ok(planned) => planned,
            Err(error) => {
                self.complaints.left_out(error.reason(), &error);
                return Ok(());
            }
        };
        self.diagnostics.latency("plan").record(taken);
        if let Err(unsent) = self.step.planned(&request, &planned, taken, Instant::now()) {
            let stamp = seconds(planned.message.header.stamp);
            let text = format_args!("the plan from the frame of {stamp} is not sent: {unsent}");
            self.complaints.left_out(unsent.reason(), &text);
            return Ok(());
        }
        plans.publish(&Plan {
            // A search takes seconds: far below what 64 bits of nanoseconds hold.
            time_taken: RosDuration::from_nanos(taken.as_nanos() as i64),
            ..planned.message
        })?;
        if let Some(pictures) = pictures {
            outcomes.publish(&pictures)?;
        }
        Ok(())
    }
}
