//! The planner on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use wm_model::planner::PlannedActions;
use wm_msgs::{
    builtin_interfaces::Duration as RosDuration,
    wm_msgs::{Action, ActionChunk, Latent, Plan, Reset, ResetResponse},
};
use wm_ros::{Node, NodeArgs, Publisher, Qos, Received};

use super::{
    Goal, PlanRequest, PlanWait, PlannerError, PlannerModel, PlannerStep, parameters::Parameters,
};
use crate::{
    complaints::Complaints,
    encoder::{CameraFrame, EncoderError, EncoderStep},
    latent_message::LatentDtype,
    model_choice,
    timeline::{Arrival, Wait, seconds},
    transport::{ImageSubscription, Transports},
    work::Work,
};

/// The node's default name.
pub const NAME: &str = "planner";

/// Runs the node until SIGINT or SIGTERM.
///
/// # Errors
/// Wrong arguments or parameters, weights that cannot be loaded, the graph.
pub fn run(args: &NodeArgs) -> Result<()> {
    args.expect_no_rest()?;
    wm_ros::run(NAME, crate::NAMESPACE, args, body)
}

/// The node itself, in a process that may hold others.
///
/// # Errors
/// As [`run`].
pub async fn body(node: Node) -> Result<()> {
    let chosen = model_choice::declare(&node)?;
    let transports = Transports::declare(&node)?;
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    let (encoder, model) = tokio::task::spawn_blocking(move || -> Result<_> {
        Ok((chosen.encoder()?, chosen.predictor()?))
    })
    .await??;
    let timing = model_choice::timing(parameters.frame_period, &model.encoding);
    let step = PlannerStep::new(parameters.settings(), timing, model.space.clone());
    tracing::info!(
        "planning with {} in latent space {}",
        model.name,
        model.space
    );
    let integration_steps = match parameters.integration_steps {
        0 => model.transition.config().sampler.steps,
        steps => steps,
    };
    let model = PlannerModel::new(
        model,
        parameters.cem()?,
        integration_steps,
        parameters.max_translation,
        parameters.max_rotation,
    )?;
    let encoder = EncoderStep::new(encoder, LatentDtype::F32);
    let mut planner = Planner::new(&node, &parameters, step, model, encoder)?;
    planner.run(&node, transports).await
}

type Planned = (
    PlanRequest,
    Result<(PlannedActions, Plan), PlannerError>,
    Duration,
);

struct Planner {
    step: PlannerStep,
    plans: Publisher<Plan>,
    complaints: Complaints,
    diagnostics: wm_ros::Diagnostics,
    /// The newest goal is enough: one may wait.
    goals: Work<CameraFrame, Result<Goal, EncoderError>>,
    searches: Work<PlanRequest, Planned>,
}

impl Planner {
    fn new(
        node: &Node,
        parameters: &Parameters,
        step: PlannerStep,
        model: PlannerModel,
        encoder: EncoderStep,
    ) -> Result<Self> {
        let encoder = Mutex::new(encoder);
        let goals = Work::new(1, move |frame: CameraFrame| {
            let encoder = encoder.lock().unwrap_or_else(PoisonError::into_inner);
            let values = encoder.encode_values(&frame.decode()?)?;
            if values.iter().any(|value| !value.is_finite()) {
                return Err(wm_model::Error::NotFinite {
                    what: "the goal's latent",
                }
                .into());
            }
            Ok(Goal {
                stamp: frame.header().stamp,
                values: Arc::from(values),
            })
        });
        let (deadline, shutdown) = (parameters.deadline, node.shutdown());
        let searches = Work::new(1, move |request: PlanRequest| {
            let started = Instant::now();
            let is_late = || deadline.is_some_and(|deadline| started.elapsed() >= deadline);
            let found = model.plan(&request, &mut || shutdown.is_triggered() || is_late());
            (request, found, started.elapsed())
        });
        Ok(Self {
            step,
            plans: node.publisher("plan", Qos::reliable(10))?,
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
            goals,
            searches,
        })
    }

    async fn run(&mut self, node: &Node, transports: Transports) -> Result<()> {
        let mut images = ImageSubscription::new(node, "goal/image", transports, Qos::reliable(10))?;
        let mut latents = node.subscription::<Latent>("latent", Qos::sensor_data())?;
        let mut actions = node.subscription::<Action>("action", Qos::reliable(10))?;
        let mut chunks = node.subscription::<ActionChunk>("action_chunk", Qos::reliable(10))?;
        let mut resets = node.service::<Reset>("~/reset")?;
        let mut jumps = node.clock().jumps();
        loop {
            // Actions before latents: an action and the frame of the same moment may both be there.
            tokio::select! {
                biased;
                finished = self.searches.finished() => self.planned(finished.context("the planner's thread")?)?,
                finished = self.goals.finished() => self.goal(finished.context("the goal's thread")?),
                Some(call) = resets.recv() => {
                    let seed = (!call.request.keep_seed).then_some(call.request.seed);
                    let message = self.step.reset(seed);
                    tracing::info!("reset: {message}");
                    if let Err(error) = call.respond(&ResetResponse { success: true, message }) {
                        tracing::warn!("reset is not answered: {error}");
                    }
                }
                Ok(()) = jumps.changed() => {
                    if self.step.clock_jumped(node.now()) {
                        tracing::info!("/clock jumped back: history flushed");
                    }
                }
                received = images.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    if self.goals.submit(message).is_some() {
                        self.complaints.left_out("superseded_goal", &"a newer goal came before this one was encoded");
                    }
                }
                received = actions.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    let taken = self.step.action(&message);
                    self.note(taken);
                }
                received = chunks.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    let taken = self.step.chunk(&message).map(|()| Arrival::default());
                    self.note(taken);
                }
                received = latents.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    let taken = self.step.latent(&message);
                    if self.note(taken) {
                        self.plan();
                    }
                }
            }
        }
    }

    /// Reports what an input did; whether it was taken.
    fn note(&mut self, taken: Result<Arrival, PlannerError>) -> bool {
        match taken {
            Ok(arrival) => {
                if arrival.flushed {
                    tracing::info!("time jumped: history flushed");
                }
                true
            }
            Err(error) => {
                self.complaints.left_out(error.reason(), &error);
                false
            }
        }
    }

    fn goal(&mut self, goal: Result<Goal, EncoderError>) {
        match goal {
            Ok(goal) => {
                tracing::info!("goal set: the image of {}", seconds(goal.stamp));
                self.step.set_goal(goal);
                self.plan();
            }
            Err(error) => self
                .complaints
                .left_out("bad_goal", &format_args!("goal image: {error}")),
        }
    }

    /// Starts a search where one is due, or says what it waits for.
    fn plan(&mut self) {
        match self.step.request() {
            Ok(request) => {
                self.complaints.working("planning");
                if self.searches.submit(request).is_some() {
                    self.complaints
                        .left_out("overload", &"planning takes longer than plan_period");
                }
            }
            Err(PlanWait::Recent) => self.complaints.working("planning"),
            Err(wait @ PlanWait::NoGoal) => self.complaints.waiting("goal", true, &wait),
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

    fn planned(&mut self, (request, found, taken): Planned) -> Result<()> {
        match found {
            Ok((actions, mut plan)) => {
                // A search takes seconds: far below what 64 bits of nanoseconds hold.
                plan.time_taken = RosDuration::from_nanos(taken.as_nanos() as i64);
                self.diagnostics.latency("plan").record(taken);
                if self.step.planned(&request, &actions) {
                    self.plans.publish(&plan)?;
                } else {
                    self.complaints.left_out(
                        "stale_plan",
                        &format_args!(
                            "the plan from {} came after a new goal, a reset or a jump of time",
                            seconds(plan.header.stamp)
                        ),
                    );
                }
            }
            Err(error) => self.complaints.left_out(error.reason(), &error),
        }
        Ok(())
    }
}
