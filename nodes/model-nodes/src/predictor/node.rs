//! The predictor on the wire.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use tokio::sync::watch;
use wm_msgs::wm_msgs::{Action, ActionChunk, Latent, Prediction, PredictionError, Reset};
use wm_ros::{
    Clock, Deadline, Descriptor, Diagnostics, Input, Lifecycle, Managed, Node, NodeArgs, Parameter,
    Publisher, Qos, Received, Service, Subscription,
};

use super::{
    Outcome, PredictorModel, PredictorSettings, PredictorStep, RolloutRequest, RunningRollout,
};
use crate::{
    chunk_merging,
    history::{
        Arrival, ChunkMerging, History, HistoryError, HistorySettings, Reception, note, seconds,
    },
    model_choice::{self, ModelChoice},
    reset::answer_reset,
    work::{Stop, Work},
};
use wm_ros::complaints::Complaints;
use wm_wire::latent_message::{LATENT_QOS, LatentDtype};

/// The node's default name.
pub const NAME: &str = "predictor";

/// Observations that may wait for the rollout that is under way. A newer one takes the place.
const WAITING: usize = 1;
/// What to do where inputs stay away, or rollouts take too long.
const NO_ENCODER: &str = "start the encoder";
const NO_ACTIONS: &str =
    "start the arm's driver, or remap /wm/action to its topic; until then the last action is held";
const SLOW: &str = "observations are left out; shorten the parameter horizon or integration_steps, or give the predictor more \
                    processor time";

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
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    let predictor = PredictorNode {
        node,
        model,
        parameters,
    };
    lifecycle.run(predictor).await
}

struct PredictorNode {
    node: Node,
    model: ModelChoice,
    parameters: Parameters,
}

struct Parameters {
    horizon: Parameter<i64>,
    integration_steps: Parameter<i64>,
    merging: ChunkMerging,
    seed: i64,
    context_frames: i64,
    frame_period: f64,
}

impl Parameters {
    fn declare(node: &Node) -> Result<Self> {
        let horizon = Descriptor::new("model steps of a rollout").integers(1, 64);
        let steps =
            Descriptor::new("Euler steps a predicted frame; 0: what the model was trained for")
                .integers(0, 1000);
        let seed = Descriptor::new("seed of the noise").read_only();
        let context =
            Descriptor::new("observed frames, one model step apart, that a rollout starts from");
        let period =
            Descriptor::new("time from one camera frame to the next [s], as the model was trained");
        Ok(Self {
            horizon: node.declare("horizon", 8_i64, horizon)?,
            integration_steps: node.declare("integration_steps", 0_i64, steps)?,
            merging: chunk_merging::declare(node)?,
            seed: node.declare("seed", 0_i64, seed)?.get(),
            context_frames: node
                .declare("context_frames", 2_i64, context.integers(1, 64).read_only())?
                .get(),
            frame_period: node
                .declare(
                    "frame_period",
                    0.2_f64,
                    period.floats(1e-3, 60.0).read_only(),
                )?
                .get(),
        })
    }
}

/// What the rollout's thread shares with the message loop.
#[derive(Clone)]
struct Shared {
    step: Arc<Mutex<PredictorStep>>,
    model: Arc<PredictorModel>,
    predictions: Publisher<Prediction>,
    errors: Publisher<PredictionError>,
    diagnostics: Diagnostics,
    clock: Clock,
    /// From one camera frame to the next: a rollout that takes longer keeps the next one waiting.
    frame_period: Duration,
}

struct Active {
    latents: Subscription<Latent>,
    actions: Subscription<Action>,
    chunks: Subscription<ActionChunk>,
    resets: Service<Reset>,
    jumps: watch::Receiver<u64>,
    shared: Shared,
    work: Work<(RolloutRequest, Instant), Result<()>>,
    /// Predictions given up that have been counted.
    unscored: u64,
    complaints: Complaints,
}

impl Managed for PredictorNode {
    type Configured = Arc<PredictorModel>;
    type Active = Active;
    type Error = anyhow::Error;

    async fn configure(&self) -> Result<Self::Configured> {
        let model = self.model.clone();
        let model = tokio::task::spawn_blocking(move || model.open()?.predictor()).await??;
        tracing::info!(
            "predicting with {} in latent space {}",
            model.name,
            model.space
        );
        Ok(Arc::new(model))
    }

    fn activate(&self, model: &Self::Configured) -> Result<Active> {
        let (node, parameters) = (&self.node, &self.parameters);
        let settings = PredictorSettings {
            // Descriptors keep these within small positive ranges; a seed is any 64 bits.
            horizon: parameters.horizon.get() as usize,
            integration_steps: 1,
            seed: parameters.seed as u64,
            dtype: LatentDtype::F16,
        };
        let history = HistorySettings {
            timing: model_choice::timing(parameters.frame_period, &model.encoding),
            // The descriptor keeps it positive.
            context_frames: parameters.context_frames as usize,
            merging: parameters.merging,
        };
        let (space, encoding) = (model.space.clone(), model.encoding.clone());
        let history = History::new(history, space, encoding, node.now());
        let step = PredictorStep::new(settings, history);
        let shared = Shared {
            step: Arc::new(Mutex::new(step)),
            model: Arc::clone(model),
            predictions: node.publisher("predicted", Qos::best_effort(16))?,
            errors: node.publisher("prediction_error", Qos::reliable(16))?,
            diagnostics: node.diagnostics(),
            clock: node.clock(),
            // The descriptor keeps it positive and within a minute.
            frame_period: Duration::from_secs_f64(parameters.frame_period),
        };
        let runner = shared.clone();
        let work = Work::new(WAITING, move |(request, received), stop: &Stop| {
            runner.roll_out(request, received, stop)
        });
        let latents: Subscription<Latent> = node.subscription("latent", LATENT_QOS)?;
        let actions: Subscription<Action> = node.subscription("action", Qos::reliable(10))?;
        let diagnostics = node.diagnostics();
        diagnostics.expect_input(Input::new("latents", [latents.topic()], NO_ENCODER));
        let input = Input::new("actions", [actions.topic()], NO_ACTIONS);
        diagnostics.expect_input(input.dispensable());
        Ok(Active {
            latents,
            actions,
            chunks: node.subscription("action_chunk", Qos::reliable(10))?,
            resets: node.service("~/reset")?,
            jumps: node.clock().jumps(),
            shared,
            work,
            unscored: 0,
            complaints: Complaints::new(node.diagnostics()),
        })
    }

    async fn run(&self, active: &mut Active) -> Result<()> {
        loop {
            // Actions before latents: an action and the frame of the same moment may both be there.
            tokio::select! {
                biased;
                finished = active.work.finished() => {
                    if let Err(error) = finished.context("the rollout's thread")? {
                        active.complaints.left_out("rollout", &format_args!("{error:#}"));
                    }
                }
                Some(call) = active.resets.recv() => {
                    let now = active.shared.clock.now();
                    answer_reset(call, |seed| active.shared.step().reset(seed, now));
                },
                Ok(()) = active.jumps.changed() => {
                    let now = active.shared.clock.now();
                    if active.shared.step().clock_jumped(now) {
                        tracing::info!("/clock jumped back: history flushed");
                    }
                }
                received = active.actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.shared.step().action(&received.message, received.received);
                    active.note(taken);
                }
                received = active.chunks.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.shared.step().chunk(&received.message, received.received);
                    active.outcome(taken, seconds(received.message.header.stamp))?;
                }
                received = active.latents.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    active.latent(&received, &self.parameters)?;
                }
            }
        }
    }
}

impl Active {
    fn latent(&mut self, received: &Received<Latent>, parameters: &Parameters) -> Result<()> {
        let horizon = parameters.horizon.get() as usize;
        let integration_steps = match parameters.integration_steps.get() {
            0 => self.shared.model.transition.config().sampler.steps,
            // The descriptor keeps it positive.
            steps => steps as usize,
        };
        let outcome = {
            let mut step = self.shared.step();
            step.set(horizon, integration_steps);
            step.latent(&received.message, Reception::from(received))
        };
        self.outcome(outcome, seconds(received.message.header.stamp))?;
        let unscored = self.shared.step().unscored();
        if unscored > self.unscored {
            self.complaints.left_out_many(
                "unscored",
                unscored - self.unscored,
                &"more predictions wait for their moment than are kept: they get no error",
            );
            self.unscored = unscored;
        }
        Ok(())
    }

    /// Reports what an input did, and starts the rollout that is due.
    fn outcome(&mut self, outcome: Result<Outcome, HistoryError>, stamp: String) -> Result<()> {
        let (arrival, rest) = match outcome {
            Ok(outcome) => (Ok(outcome.arrival), Some((outcome.errors, outcome.rollout))),
            Err(error) => (Err(error), None),
        };
        note(&mut self.complaints, arrival);
        let Some((errors, rollout)) = rest else {
            return Ok(());
        };
        for error in &errors {
            self.shared.errors.publish(error)?;
        }
        match rollout {
            None => {}
            Some(Ok(request)) => {
                self.complaints.working("predicting");
                if self.work.submit((request, Instant::now())).is_some() {
                    self.complaints.left_out(
                        "overload",
                        &format_args!(
                            "a rollout takes longer than a frame: the observation before that of {stamp} is left out"
                        ),
                    );
                }
            }
            Some(Err(wait)) => self.complaints.waiting(wait.kind(), wait.is_usual(), &wait),
        }
        Ok(())
    }

    fn note(&mut self, arrival: Result<Arrival, HistoryError>) {
        note(&mut self.complaints, arrival);
    }
}

impl Shared {
    /// The state stays whole if a thread panics between two messages.
    fn step(&self) -> MutexGuard<'_, PredictorStep> {
        self.step.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Computes one rollout and sends each step when it is ready; stops where time has jumped or the node is no longer
    /// active.
    fn roll_out(&self, request: RolloutRequest, received: Instant, stop: &Stop) -> Result<()> {
        let started = Instant::now();
        let rollout = RunningRollout::new(&self.model, request)?;
        for (index, predicted) in rollout.enumerate() {
            let mut predicted = predicted?;
            if stop.is_asked() || predicted.prediction.epoch != self.step().epoch() {
                return Ok(());
            }
            predicted.prediction.ready_stamp = self.clock.now();
            self.predictions.publish(&predicted.prediction)?;
            if index == 0 {
                self.diagnostics
                    .latency("latent to first step")
                    .record(received.elapsed());
            }
            let late = self.step().predicted(&predicted);
            if let Some(error) = late {
                self.errors.publish(&error)?;
            }
        }
        let (taken, limit) = (started.elapsed(), self.frame_period);
        self.diagnostics.latency("rollout").record(taken);
        let deadline = Deadline {
            stage: "rollout",
            limit,
            advice: SLOW,
        };
        self.diagnostics.took(deadline, taken);
        Ok(())
    }
}
