//! The planner's ROS interface.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use tokio::sync::mpsc;
use wm_model::LatentSpace;
use wm_msgs::{
    builtin_interfaces::{Duration as RosDuration, Time},
    geometry_msgs::PoseStamped,
    visualization_msgs::MarkerArray,
    wm_msgs::{Goal as GoalMessage, Plan, action::Plan as PlanAction},
};
use wm_ros::{
    ActionServer, Diagnostics, GoalId, GoalRequest, Level, NodeDefinition, Publisher, Qos,
    Subscription, complaints::Complaints, frame_trace,
};
use wm_zoo::ModelFolder;

use super::{
    ActionRun, Course, End, Goal, GoalError, GoalReader, PlanRequest, PlanWait, Planned,
    PlannerError, PlannerModel, PlannerParts, PlannerStep, SearchProgress, markers::markers,
    parameters::Parameters, workers,
};
use crate::{
    cadence::{Cadence, SKIPPED, rough},
    encoder::EncoderStep,
    harness::{
        self, Follower, GoalInputs, Goals, Inputs, ModelNode, ModelSetup, OTHER_SPACE, Outcome,
    },
    history::{FROZEN_CAMERA, HistoryBuilder, Wait, seconds},
    pool::Pool,
    work::{Stop, Work},
};
use wm_wire::{
    latent_message::LatentDtype,
    transport::{ImagePublisher, Pictures, Transports},
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Planner>();

/// JPEG quality of the predicted picture of a plan.
const JPEG_QUALITY: u8 = 90;

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// Inputs about the robot.
        inputs: Inputs;
        /// What says what to reach.
        goals: GoalInputs;
        /// Where the end effector is, for the workspace box and the markers.
        poses: Subscription<PoseStamped> = "ee_pose", qos(Qos::best_effort(1));
        /// The best actions found.
        plans: Publisher<Plan> = "plan", qos(Qos::reliable(10));
        /// Plans for a goal once, or again and again until it is reached. The newest goal counts, by topic or action.
        actions: ActionServer<PlanAction> = "~/plan";
        /// What the camera would see after the last of them, stamped with that time. Made while somebody subscribes.
        outcomes: ImagePublisher = "plan/image", qos(Qos::reliable(4));
        /// The subgoals of a plan side by side, nearest first. Made while somebody subscribes.
        subgoals: ImagePublisher = "plan/subgoals/image", qos(Qos::reliable(4));
        /// The way of the end effector (ns plan), where ee_pose is heard. Made while somebody subscribes.
        shapes: Publisher<MarkerArray> = "markers", qos(Qos::reliable(4));
    }
}

/// The loaded parts of the model.
struct Model {
    goals: GoalReader,
    planner: Arc<PlannerModel>,
    history: HistoryBuilder,
    pool: Pool,
}

/// The result of a search, and its duration.
struct Finished {
    request: PlanRequest,
    planned: Result<Planned, PlannerError>,
    pictures: Option<Pictures>,
    subgoals: Option<Pictures>,
    taken: Duration,
}

/// Most feedback messages that wait.
const MOST_FEEDBACK: usize = 64;

struct Planner {
    planner: Arc<PlannerModel>,
    follower: Follower,
    step: PlannerStep,
    goals: Goals,
    /// Reads the goals of actions.
    read: Work<(GoalId, GoalMessage), (GoalId, Result<Goal, GoalError>)>,
    action: Option<ActionRun>,
    /// The progress of searches, for the feedback of the action.
    progress: mpsc::Receiver<SearchProgress>,
    searches: Work<PlanRequest, Finished>,
    is_searching: bool,
    /// Whether a plan became due during a search.
    is_behind: bool,
    /// Least time between two plans; zero: no limit.
    period: Duration,
    /// Measures whether searches take longer than the period.
    cadence: Cadence,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl ModelNode for Planner {
    const NAME: &'static str = "planner";
    const ABOUT: &'static str = "Plans actions that lead to a goal.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;

    fn space(model: &Model) -> Option<&LatentSpace> {
        Some(model.history.space())
    }

    fn check(parameters: &Parameters) -> Result<()> {
        parameters.workspace().map(drop)
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let encoder = EncoderStep::of_model(&folder, LatentDtype::F32)?;
        let model = folder.world_model()?;
        let (frame_period, merging) = (parameters.frame_period, parameters.chunk_merging.0);
        let context_frames = parameters.context_frames.min(64);
        let history = HistoryBuilder::new(&model, frame_period, context_frames, merging);
        let (name, space) = (model.name.clone(), model.space.clone());
        let place = model.transition.place();
        let setup = parameters.setup(history.timing().step_ns() as f64 / 1e9)?;
        let probe = match setup.success > 0.0 {
            true => folder.probe()?.map(Arc::new),
            false => None,
        };
        let workers = workers::connect(&model, &parameters.workers, &parameters.workers_config)?;
        let parts = PlannerParts {
            model,
            idm: folder.idm()?.map(Arc::new),
            subgoals: folder.subgoals()?.map(Arc::new),
            distance: folder.distance()?.map(Arc::new),
            probe: probe.clone(),
            decoder: folder
                .decoder()?
                .map(|decoder| Arc::new(Mutex::new(decoder))),
            workers,
        };
        let planner = PlannerModel::new(parts, setup)?;
        let choice = planner.choice();
        tracing::info!("planning with {name} by {choice} in latent space {space} on {place}");
        Ok(Model {
            goals: GoalReader::new(encoder).with_probe(probe),
            planner: Arc::new(planner),
            history,
            pool: Pool::background(Planner::NAME, parameters.nice)?,
        })
    }

    fn activate(at: &ModelSetup<Self>) -> Result<Self> {
        let (node, model) = (&at.node, &at.resources);
        let (deadline, planner) = (at.parameters.deadline, Arc::clone(&model.planner));
        let transports = at.parameters.image_transport;
        let (sender, receiver) = mpsc::channel(MOST_FEEDBACK);
        let searches = Work::new(1, move |request: PlanRequest, stop: &Stop| {
            let started = Instant::now();
            let is_late = || !deadline.is_zero() && started.elapsed() >= deadline;
            let mut sent = None;
            let planned = planner.plan(&request, &mut |progress, terms| {
                let progress = SearchProgress::of(progress, terms);
                if let Some(progress) = progress.filter(|_| request.is_followed)
                    && sent.replace(progress.iteration()) != Some(progress.iteration())
                {
                    // If the queue is full, this feedback is dropped: only new feedback matters.
                    sender.try_send(progress).ok();
                }
                stop.is_asked() || is_late()
            });
            let taken = started.elapsed();
            let planned_pictures = |of: fn(&Planned, Transports) -> Option<Pictures>| {
                let planned = planned.as_ref().ok();
                planned.and_then(|planned| of(planned, transports))
            };
            let (pictures, subgoals) = (
                planned_pictures(outcome_pictures),
                planned_pictures(subgoal_pictures),
            );
            Finished {
                request,
                planned,
                pictures,
                subgoals,
                taken,
            }
        })
        .on(&model.pool);
        let history = model.history.begin(node.now());
        // The range keeps it within an hour.
        let period = Duration::from_secs_f64(at.parameters.plan_period);
        let reader = model.goals.clone();
        let read =
            move |(id, message): (GoalId, GoalMessage), _: &Stop| (id, reader.of_message(&message));
        Ok(Self {
            planner: Arc::clone(&model.planner),
            follower: Follower::new(node, &at.endpoints.inputs, "start the encoder")
                .keeping(at.endpoints.handover()),
            step: PlannerStep::new(at.parameters.settings(), history),
            goals: Goals::new(
                model.goals.clone(),
                &model.pool,
                at.parameters.follows_model(),
            ),
            read: Work::new(1, read).on(&model.pool),
            action: None,
            progress: receiver,
            searches,
            is_searching: false,
            is_behind: false,
            period,
            cadence: Cadence::new(period, None),
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
        })
    }

    fn adopt(&mut self, at: &mut ModelSetup<Self>, model: Model) -> Result<()> {
        at.resources = model;
        let mut new = Self::activate(at)?;
        let is_same = new.step.continue_from(&self.step, at.node.now());
        if let Some(run) = &self.action {
            let is_wanted = !is_same || self.read.is_running();
            if is_wanted && !is_same && !run.message().latents.is_empty() {
                self.end(End::Aborted(OTHER_SPACE.to_owned()))?;
            } else if is_wanted {
                // The new model has read none yet.
                let _ = new.read.submit((run.id(), run.message().clone()));
            }
        }
        let has_goal = self.step.has_goal() && self.action.is_none();
        if !new.goals.continue_from(&self.goals, has_goal, is_same) {
            self.complaints
                .left_out("goal_of_other_space", &OTHER_SPACE);
        }
        new.action = self.action.take();
        *self = new;
        Ok(())
    }

    async fn run(&mut self, at: &mut ModelSetup<Self>) -> Result<()> {
        let Endpoints {
            inputs,
            goals,
            poses,
            plans,
            actions,
            outcomes,
            subgoals,
            shapes,
        } = &mut *at.endpoints;
        let shown = Shown { outcomes, subgoals };
        loop {
            tokio::select! {
                biased;
                finished = self.searches.finished() => {
                    self.is_searching = false;
                    self.planned(finished.context("the planner's thread")?, plans, &shown, shapes)?;
                    self.plan(&shown);
                }
                end = ActionRun::over(self.action.as_ref()) => self.end(end)?,
                Some(progress) = self.progress.recv() => {
                    if let Some(run) = &self.action {
                        run.publish_feedback(&run.course.feedback(progress))?;
                    }
                }
                Some(request) = actions.recv() => self.request(request)?,
                read = self.read.finished() => {
                    let (id, goal) = read.context("the goal's thread")?;
                    // The action may have ended before its goal was read.
                    if self.action.as_ref().is_some_and(|run| run.id() == id) {
                        match goal {
                            Ok(goal) => {
                                self.step.set_goal(goal, at.node.now());
                                self.plan(&shown);
                            }
                            Err(error) => self.end(End::Aborted(format!("goal: {error}")))?,
                        }
                    }
                }
                goal = self.goals.next(goals, &mut self.complaints) => {
                    let Some(goal) = goal? else { return Ok(()) };
                    self.end(End::Aborted("a newer goal came on a topic".to_owned()))?;
                    self.step.set_goal(goal, at.node.now());
                    self.plan(&shown);
                }
                Some(pose) = poses.recv() => {
                    if !self.step.pose(&pose.message, pose.at) {
                        self.complaints.left_out("bad_pose", &"ee_pose: a position that is not finite");
                    }
                }
                event = self.follower.next(inputs) => {
                    let Some(event) = event else { return Ok(()) };
                    let outcome = self.follower.apply(event, &mut self.step, &mut self.complaints);
                    if let Some(Outcome::Latent(())) = outcome {
                        self.plan(&shown);
                    }
                }
            }
        }
    }
}

/// Where a plan's pictures go.
struct Shown<'a> {
    outcomes: &'a ImagePublisher,
    subgoals: &'a ImagePublisher,
}

/// The pictures of the subgoals, if there are any.
fn subgoal_pictures(planned: &Planned, transports: Transports) -> Option<Pictures> {
    let picture = planned.subgoals.as_ref()?;
    let header = planned.message.header.clone();
    // As in `outcome_pictures`.
    Pictures::encode(picture, header, transports, JPEG_QUALITY).ok()
}

/// The predicted pictures at the end of a plan, if it has an outcome.
fn outcome_pictures(planned: &Planned, transports: Transports) -> Option<Pictures> {
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
    // JPEG fails only for pictures of more than 65535 pixels in a row, which no decoder makes.
    Pictures::encode(outcome, header, transports, JPEG_QUALITY).ok()
}

impl Planner {
    /// Starts a search if one is due, or reports what it waits for.
    fn plan(&mut self, shown: &Shown<'_>) {
        if self.is_searching {
            // The next search starts at the end of this one, from the newest frame.
            self.is_behind |= !self.period.is_zero() && self.step.is_due();
            return;
        }
        match self.step.request(Instant::now()) {
            Ok(mut request) => {
                request.is_shown = shown.outcomes.subscribers() > 0;
                request.shows_subgoals = shown.subgoals.subscribers() > 0;
                request.is_followed = self.action.is_some();
                self.complaints.working("planning");
                self.count_missed_plans(&request);
                self.is_searching = true;
                // No search waits, so the queue drops none.
                let _ = self.searches.submit(request);
            }
            Err(PlanWait::Recent) => self.complaints.working("planning"),
            Err(wait @ PlanWait::NoGoal) => self.complaints.waiting("goal", true, &wait),
            Err(wait @ (PlanWait::NoPose { .. } | PlanWait::PoseFrame { .. })) => {
                self.complaints.waiting("pose", false, &wait);
            }
            Err(PlanWait::History(wait @ Wait::NoFrame)) => {
                self.complaints.waiting(
                    "frame",
                    false,
                    &format_args!("a goal is set, but {wait} on latent"),
                );
            }
            Err(wait @ PlanWait::Frozen { is_due }) => {
                self.diagnostics
                    .count_drops(FROZEN_CAMERA, u64::from(is_due));
                self.complaints.waiting(FROZEN_CAMERA, false, &wait);
                self.diagnostics
                    .raise("camera", Level::Error, wait.to_string());
            }
            Err(wait @ PlanWait::History(Wait::CameraClock(_))) => {
                self.complaints.waiting("camera clock", false, &wait);
                self.diagnostics
                    .raise("camera clock", Level::Error, wait.to_string());
            }
            Err(wait @ PlanWait::History(Wait::Context { .. })) => {
                self.complaints.waiting("context", true, &wait);
            }
            Err(wait) => self.complaints.waiting("history", false, &wait),
        }
    }

    /// Counts the plans that were due during the last search: skipped by choice if searches usually take longer than the
    /// period, otherwise dropped.
    fn count_missed_plans(&mut self, request: &PlanRequest) {
        if !std::mem::take(&mut self.is_behind) {
            return;
        }
        let step_s = request.moment.timing.step_ns() as f32 / 1e9;
        let periods = request.passed_steps * step_s / self.period.as_secs_f32();
        // A handful; a cast saturates.
        let missed = (periods.round() as u64).saturating_sub(1);
        if self.cadence.nth() > 1 {
            self.diagnostics.count_skipped(SKIPPED, missed);
        } else if missed > 0 {
            let text = "planning takes longer than before or than plan_period";
            self.complaints.left_out_many("overload", missed, &text);
        }
    }

    /// Notes the duration of a search, and reports a change of the time between plans.
    fn took(&mut self, taken: Duration) {
        if self.period.is_zero() {
            return;
        }
        self.cadence.took(taken);
        if let Some((taken, period)) = self.cadence.change() {
            let (taken, period) = (rough(taken), rough(period));
            let text = format!("a plan takes about {taken} here, of a plan_period of {period}");
            match self.cadence.nth() {
                1 => tracing::info!("{text}"),
                _ => tracing::warn!(
                    "{text}: each search begins when the one before is over; for more: a smaller population, horizon or \
                     deadline, a smaller model, or a faster processor"
                ),
            }
        }
    }

    fn planned(
        &mut self,
        finished: Finished,
        plans: &Publisher<Plan>,
        shown: &Shown<'_>,
        shapes: &Publisher<MarkerArray>,
    ) -> Result<()> {
        let Finished {
            request,
            planned,
            pictures,
            subgoals,
            taken,
        } = finished;
        let planned = match planned {
            Ok(planned) => planned,
            Err(error) => {
                self.complaints.left_out(error.reason(), &error);
                return match self.step.is_current(&request) {
                    true => self.end(End::Aborted(error.to_string())),
                    false => Ok(()),
                };
            }
        };
        self.diagnostics.latency("plan").record(taken);
        self.took(taken);
        if let Some(counts) = self.planner.worker_counts() {
            workers::report(&self.diagnostics, counts);
        }
        if let Err(unsent) = self.step.planned(&request, &planned, taken, Instant::now()) {
            let stamp = seconds(planned.message.header.stamp);
            let text = format_args!("the plan from the frame of {stamp} is not sent: {unsent}");
            self.complaints.left_out(unsent.reason(), &text);
            return Ok(());
        }
        let plan = Plan {
            // A search takes seconds; 64 bits of nanoseconds hold 292 years.
            time_taken: RosDuration::from_nanos(taken.as_nanos() as i64),
            ..planned.message
        };
        let run = self.action.as_mut();
        if run.as_ref().is_none_or(|run| run.course.is_published()) {
            plans.publish(&plan)?;
            frame_trace::passed("plan published", plan.header.stamp);
        }
        if let Some(pictures) = pictures {
            shown.outcomes.publish(&pictures)?;
        }
        if let Some(subgoals) = subgoals {
            shown.subgoals.publish(&subgoals)?;
        }
        if let Some(begin) = request.position.filter(|_| shapes.subscribers() > 0)
            && let Some(made) = markers(&plan, begin, self.step.action_space())
        {
            shapes.publish(&made)?;
        }
        let Some(run) = run else { return Ok(()) };
        run.publish_feedback(&run.course.summary(&plan))?;
        match run.course.planned(&plan) {
            Some(end) => self.end(end),
            None => Ok(()),
        }
    }

    /// Takes the goal of an action. It replaces a running one.
    fn request(&mut self, request: GoalRequest<PlanAction>) -> Result<()> {
        let course = match Course::new(&request.goal, Instant::now()) {
            Ok(course) => course,
            Err(reason) => {
                let text = format!("the goal of an action is rejected: {reason}");
                self.complaints.left_out("bad_goal", &text);
                request.reject();
                return Ok(());
            }
        };
        self.end(End::Aborted("a newer goal came".to_owned()))?;
        // No search for the previous goal starts while this goal is read.
        self.step.clear_goal();
        let unread = (request.id(), request.goal.goal.clone());
        match request.accept() {
            Ok(goal) => {
                self.action = Some(ActionRun::new(goal, course));
                // A dropped goal belongs to an action that has ended.
                let _ = self.read.submit(unread);
            }
            Err(error) => self.complaints.left_out("bad_goal", &error),
        }
        Ok(())
    }

    /// Ends the running action, if there is one, and drops its goal.
    fn end(&mut self, end: End) -> Result<()> {
        if let Some(run) = self.action.take() {
            tracing::info!("an action has ended: {end:?}");
            self.step.clear_goal();
            run.end(end)?;
        }
        Ok(())
    }
}
