//! The planner on the wire.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use tokio::sync::watch;
use wm_model::{LatentSpace, actions::ActionEncoding, planner::PlannedActions};
use wm_msgs::{
    builtin_interfaces::Duration as RosDuration,
    wm_msgs::{Action, ActionChunk, Latent, Plan, Reset},
};
use wm_ros::{
    Diagnostics, Input, Lifecycle, Managed, Node, NodeArgs, Publisher, Qos, Received, Service,
    Subscription,
};

use super::{
    Goal, PlanRequest, PlanWait, PlannerError, PlannerModel, PlannerStep, parameters::Parameters,
};
use crate::{
    encoder::{EncoderError, EncoderStep},
    history::{Arrival, History, HistoryError, HistorySettings, Reception, Wait, note, seconds},
    model_choice::{self, ModelChoice},
    pool::Pool,
    reset::answer_reset,
    work::{Stop, Work},
};
use wm_ros::complaints::Complaints;
use wm_wire::{
    camera_frame::CameraFrame,
    latent_message::{LATENT_QOS, LatentDtype},
    transport::{ImageSubscription, Transports},
};

/// The node's default name.
pub const NAME: &str = "planner";
/// Where processors are short, a plan may come later than a prediction.
const NICE: i64 = 15;

/// Runs the node until SIGINT or SIGTERM.
///
/// # Errors
/// Wrong arguments or parameters, weights that cannot be loaded, the graph.
pub fn run(args: &NodeArgs) -> Result<()> {
    args.expect_no_rest()?;
    wm_ros::run(NAME, wm_ros::NAMESPACE, args, body)
}

/// The node itself, in a process that may hold others.
///
/// # Errors
/// As [`run`].
pub async fn body(node: Node) -> Result<()> {
    let lifecycle = Lifecycle::new(&node)?;
    let model = model_choice::declare(&node)?;
    let transports = Transports::declare(&node)?;
    let parameters = Parameters::declare(&node)?;
    let pool = Pool::declare(&node, NICE)?;
    node.seal_parameters()?;
    let planner = PlannerNode {
        node,
        model,
        transports,
        parameters,
        pool,
    };
    lifecycle.run(planner).await
}

struct PlannerNode {
    node: Node,
    model: ModelChoice,
    transports: Transports,
    parameters: Parameters,
    pool: Pool,
}

struct Configured {
    encoder: Arc<Mutex<EncoderStep>>,
    model: Arc<PlannerModel>,
    history: HistorySettings,
    space: LatentSpace,
    encoding: ActionEncoding,
}

type Planned = (
    PlanRequest,
    Result<(PlannedActions, Plan), PlannerError>,
    Duration,
);

struct Active {
    images: ImageSubscription,
    latents: Subscription<Latent>,
    actions: Subscription<Action>,
    chunks: Subscription<ActionChunk>,
    resets: Service<Reset>,
    jumps: watch::Receiver<u64>,
    step: PlannerStep,
    plans: Publisher<Plan>,
    complaints: Complaints,
    diagnostics: Diagnostics,
    /// The newest goal is enough: one may wait.
    goals: Work<CameraFrame, Result<Goal, EncoderError>>,
    searches: Work<PlanRequest, Planned>,
}

impl Managed for PlannerNode {
    type Configured = Configured;
    type Active = Active;
    type Error = anyhow::Error;

    async fn configure(&self) -> Result<Configured> {
        let chosen = self.model.clone();
        let (encoder, model) = tokio::task::spawn_blocking(move || -> Result<_> {
            let model = chosen.open()?;
            Ok((model.encoder()?, model.predictor()?))
        })
        .await??;
        let parameters = &self.parameters;
        let history = HistorySettings {
            timing: model_choice::timing(parameters.frame_period, &model.encoding),
            context_frames: parameters.context_frames,
            merging: parameters.merging,
        };
        let (space, encoding) = (model.space.clone(), model.encoding.clone());
        tracing::info!("planning with {} in latent space {space}", model.name);
        let integration_steps = match parameters.integration_steps {
            0 => model.transition.config().sampler.steps,
            steps => steps,
        };
        let model = PlannerModel::new(
            model,
            parameters.cem()?,
            &parameters.search,
            integration_steps,
            parameters.max_translation,
            parameters.max_rotation,
        )?;
        let encoder = EncoderStep::new(encoder, LatentDtype::F32);
        Ok(Configured {
            encoder: Arc::new(Mutex::new(encoder)),
            model: Arc::new(model),
            history,
            space,
            encoding,
        })
    }

    fn activate(&self, configured: &Configured) -> Result<Active> {
        let node = &self.node;
        let (deadline, model) = (self.parameters.deadline, Arc::clone(&configured.model));
        let searches = Work::new(1, move |request: PlanRequest, stop: &Stop| {
            let started = Instant::now();
            let is_late = || deadline.is_some_and(|deadline| started.elapsed() >= deadline);
            let found = model.plan(&request, &mut || stop.is_asked() || is_late());
            (request, found, started.elapsed())
        })
        .on(&self.pool);
        let history = History::new(
            configured.history,
            configured.space.clone(),
            configured.encoding.clone(),
            node.now(),
        );
        let latents: Subscription<Latent> = node.subscription("latent", LATENT_QOS)?;
        let input = Input::new("latents", [latents.topic()], "start the encoder");
        node.diagnostics().expect_input(input);
        Ok(Active {
            images: ImageSubscription::catching_up(
                node,
                "goal/image",
                self.transports,
                Qos::reliable(10),
            )?,
            latents,
            actions: node.subscription("action", Qos::reliable(10))?,
            chunks: node.subscription("action_chunk", Qos::reliable(10))?,
            resets: node.service("~/reset")?,
            jumps: node.clock().jumps(),
            step: PlannerStep::new(self.parameters.settings(), history),
            plans: node.publisher("plan", Qos::reliable(10))?,
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
            goals: Goal::work(&configured.encoder, &self.pool),
            searches,
        })
    }

    async fn run(&self, active: &mut Active) -> Result<()> {
        loop {
            // Actions before latents: an action and the frame of the same moment may both be there.
            tokio::select! {
                biased;
                finished = active.searches.finished() => active.planned(finished.context("the planner's thread")?)?,
                finished = active.goals.finished() => active.goal(finished.context("the goal's thread")?),
                Some(call) = active.resets.recv() => {
                    let now = self.node.now();
                    answer_reset(call, |seed| active.step.reset(seed, now));
                },
                Ok(()) = active.jumps.changed() => {
                    if active.step.clock_jumped(self.node.now()) {
                        tracing::info!("/clock jumped back: history flushed");
                    }
                }
                received = active.images.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    if active.goals.submit(message).is_some() {
                        active.complaints.left_out("superseded_goal", &"a newer goal came before this one was encoded");
                    }
                }
                received = active.actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.step.action(&received.message, received.received);
                    active.note(taken);
                }
                received = active.chunks.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.step.chunk(&received.message, received.received);
                    active.note(taken);
                }
                received = active.latents.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.step.latent(&received.message, Reception::from(&received));
                    if active.note(taken) {
                        active.plan();
                    }
                }
            }
        }
    }
}

impl Active {
    /// Reports what an input did; whether it was taken.
    fn note(&mut self, taken: Result<Arrival, HistoryError>) -> bool {
        note(&mut self.complaints, taken)
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
        match self.step.request(Instant::now()) {
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
                match self.step.planned(&request, &actions, taken, Instant::now()) {
                    Ok(()) => self.plans.publish(&plan)?,
                    Err(unsent) => {
                        let stamp = seconds(plan.header.stamp);
                        let text = format_args!(
                            "the plan from the frame of {stamp} is not sent: {unsent}"
                        );
                        self.complaints.left_out(unsent.reason(), &text);
                    }
                }
            }
            Err(error) => self.complaints.left_out(error.reason(), &error),
        }
        Ok(())
    }
}
