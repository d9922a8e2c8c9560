//! The predictor on the wire.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use wm_msgs::wm_msgs::{
    Action, ActionChunk, Latent, Prediction, PredictionError, Reset, ResetResponse,
};
use wm_ros::{
    Clock, Descriptor, Diagnostics, Node, NodeArgs, Parameter, Publisher, Qos, Received, Shutdown,
};

use super::{PredictorModel, PredictorSettings, PredictorStep, RolloutRequest, RunningRollout};
use crate::{
    complaints::Complaints,
    latent_message::LatentDtype,
    model_choice,
    timeline::{Wait, seconds},
    work::Work,
};

/// The node's default name.
pub const NAME: &str = "predictor";

/// Observations that may wait for the rollout that is under way. A newer one takes the place.
const WAITING: usize = 1;
/// An encoder that is silent for longer is reported.
const STALE: Duration = Duration::from_secs(2);

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
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    let model = Arc::new(tokio::task::spawn_blocking(move || chosen.predictor()).await??);
    let mut predictor = Predictor::new(&node, parameters, model)?;
    predictor.run(&node).await
}

struct Parameters {
    horizon: Parameter<i64>,
    integration_steps: Parameter<i64>,
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
    shutdown: Shutdown,
}

struct Predictor {
    shared: Shared,
    parameters: Parameters,
    work: Work<(RolloutRequest, Instant), Result<()>>,
    /// Predictions given up that have been counted.
    unscored: u64,
    complaints: Complaints,
}

impl Predictor {
    fn new(node: &Node, parameters: Parameters, model: Arc<PredictorModel>) -> Result<Self> {
        let settings = PredictorSettings {
            // Descriptors keep these within small positive ranges; a seed is any 64 bits.
            horizon: parameters.horizon.get() as usize,
            context_frames: parameters.context_frames as usize,
            integration_steps: 1,
            seed: parameters.seed as u64,
            dtype: LatentDtype::F16,
        };
        let timing = model_choice::timing(parameters.frame_period, &model.encoding);
        let step = PredictorStep::new(settings, timing, model.space.clone());
        tracing::info!(
            "predicting with {} in latent space {}",
            model.name,
            model.space
        );
        let shared = Shared {
            step: Arc::new(Mutex::new(step)),
            model,
            predictions: node.publisher("predicted", Qos::best_effort(16))?,
            errors: node.publisher("prediction_error", Qos::reliable(16))?,
            diagnostics: node.diagnostics(),
            clock: node.clock(),
            shutdown: node.shutdown(),
        };
        let runner = shared.clone();
        let work = Work::new(WAITING, move |(request, received)| {
            runner.roll_out(request, received)
        });
        let complaints = Complaints::new(node.diagnostics());
        Ok(Self {
            shared,
            parameters,
            work,
            unscored: 0,
            complaints,
        })
    }

    async fn run(&mut self, node: &Node) -> Result<()> {
        let mut latents = node.subscription::<Latent>("latent", Qos::sensor_data())?;
        self.shared.diagnostics.expect_input(latents.topic(), STALE);
        let mut actions = node.subscription::<Action>("action", Qos::reliable(10))?;
        let mut chunks = node.subscription::<ActionChunk>("action_chunk", Qos::reliable(10))?;
        let mut resets = node.service::<Reset>("~/reset")?;
        let mut jumps = node.clock().jumps();
        loop {
            // Actions before latents: an action and the frame of the same moment may both be there.
            tokio::select! {
                biased;
                finished = self.work.finished() => {
                    if let Err(error) = finished.context("the rollout's thread")? {
                        self.complaints.left_out("rollout", &format_args!("{error:#}"));
                    }
                }
                Some(call) = resets.recv() => {
                    let seed = (!call.request.keep_seed).then_some(call.request.seed);
                    let message = self.shared.step().reset(seed);
                    tracing::info!("reset: {message}");
                    if let Err(error) = call.respond(&ResetResponse { success: true, message }) {
                        tracing::warn!("reset is not answered: {error}");
                    }
                }
                Ok(()) = jumps.changed() => {
                    let now = self.shared.clock.now();
                    if self.shared.step().clock_jumped(now) {
                        tracing::info!("/clock jumped back: history flushed");
                    }
                }
                received = actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = self.shared.step().action(&received.message);
                    match taken {
                        Ok(arrival) if arrival.flushed => tracing::info!("time jumped: history flushed"),
                        Ok(_) => {}
                        Err(error) => self.complaints.left_out(error.reason(), &error),
                    }
                }
                received = chunks.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = self.shared.step().chunk(&received.message);
                    if let Err(error) = taken {
                        self.complaints.left_out(error.reason(), &error);
                    }
                }
                received = latents.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    self.latent(received)?;
                }
            }
        }
    }

    fn latent(&mut self, Received { message, received }: Received<Latent>) -> Result<()> {
        let arrived = Instant::now();
        let stamp = seconds(message.header.stamp);
        let horizon = self.parameters.horizon.get() as usize;
        let integration_steps = match self.parameters.integration_steps.get() {
            0 => self.shared.model.transition.config().sampler.steps,
            // The descriptor keeps it positive.
            steps => steps as usize,
        };
        let outcome = {
            let mut step = self.shared.step();
            step.set(horizon, integration_steps);
            step.latent(&message, received)
        };
        let outcome = match outcome {
            Ok(outcome) => outcome,
            Err(error) => {
                self.complaints.left_out(error.reason(), &error);
                return Ok(());
            }
        };
        for error in &outcome.errors {
            self.shared.errors.publish(error)?;
        }
        let unscored = self.shared.step().unscored();
        if unscored > self.unscored {
            self.complaints.left_out_many(
                "unscored",
                unscored - self.unscored,
                &"more predictions wait for their moment than are kept: they get no error",
            );
            self.unscored = unscored;
        }
        if outcome.arrival.flushed {
            tracing::info!("time jumped: history flushed");
        }
        if outcome.arrival.missed_frames > 0 {
            let text = format!(
                "{} frames are missing before that of {}",
                outcome.arrival.missed_frames, stamp
            );
            self.complaints
                .left_out_many("gap", outcome.arrival.missed_frames, &text);
        }
        match outcome.rollout {
            Ok(request) => {
                self.complaints.working("predicting");
                if self.work.submit((request, arrived)).is_some() {
                    self.complaints.left_out(
                        "overload",
                        &format_args!(
                            "a rollout takes longer than a frame: the observation before that of {stamp} is left out"
                        ),
                    );
                }
            }
            Err(wait) => {
                let is_usual = matches!(wait, Wait::NoFrame | Wait::Context { .. });
                self.complaints.waiting(kind(&wait), is_usual, &wait);
            }
        }
        Ok(())
    }
}

impl Shared {
    /// The state stays whole if a thread panics between two messages.
    fn step(&self) -> MutexGuard<'_, PredictorStep> {
        self.step.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Computes one rollout and sends each step when it is ready; stops where time has jumped or the node ends.
    fn roll_out(&self, request: RolloutRequest, received: Instant) -> Result<()> {
        let started = Instant::now();
        let rollout = RunningRollout::new(&self.model, request)?;
        for (index, predicted) in rollout.enumerate() {
            let mut predicted = predicted?;
            if self.shutdown.is_triggered() || predicted.epoch != self.step().epoch() {
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
        self.diagnostics
            .latency("rollout")
            .record(started.elapsed());
        Ok(())
    }
}

/// Waits of one kind are said once.
fn kind(wait: &Wait) -> &'static str {
    match wait {
        Wait::NoFrame => "no frame",
        Wait::Context { .. } => "context",
        Wait::Gap { .. } => "gap",
        Wait::NoAction { .. } => "no action",
    }
}
