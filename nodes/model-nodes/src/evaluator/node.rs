//! The evaluator on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use candle_core::IndexOp as _;
use image::RgbImage;
use tokio::{sync::watch, task::JoinError};
use wm_model::{Decoder, LatentSpace, actions::ActionEncoding, image::to_rgb};
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::{Header, String as Text},
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, Latent, Reset, Timing as TimingMessage,
    },
};
use wm_ros::{
    Clock, Descriptor, Diagnostics, Input, Lifecycle, Managed, Node, NodeArgs, Publisher, Qos,
    Received, Service, Subscription,
};
use wm_zoo::success_probe::{Instruction, SuccessClassifier};

use super::{
    Evaluation, EvaluationRequest, EvaluatorError, EvaluatorModel, EvaluatorSettings,
    EvaluatorStep, shown_steps, tile,
};
use crate::{
    chunk_merging,
    encoder::{EncoderError, EncoderStep},
    env::INSTRUCTION,
    history::{
        Arrival, ChunkMerging, History, HistoryError, HistorySettings, Reception, note, seconds,
    },
    model_choice::{self, ModelChoice},
    planner::Goal,
    pool::Pool,
    reset::answer_reset,
    work::Work,
};
use wm_ros::complaints::Complaints;
use wm_wire::{
    camera_frame::CameraFrame,
    image_message::{encode_image, encode_jpeg},
    latent_message::{LATENT_QOS, LatentDtype},
    transport::{ImageSubscription, Transports, publish_images},
};

/// The node's default name.
pub const NAME: &str = "evaluator";
/// Where processors are short, an assessment may come later than a prediction, and before a plan.
const NICE: i64 = 10;

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
    let evaluator = EvaluatorNode {
        node,
        model,
        transports,
        parameters,
        pool,
    };
    lifecycle.run(evaluator).await
}

struct EvaluatorNode {
    node: Node,
    model: ModelChoice,
    transports: Transports,
    parameters: Parameters,
    pool: Pool,
}

struct Parameters {
    settings: EvaluatorSettings,
    context_frames: usize,
    merging: ChunkMerging,
    integration_steps: usize,
    frame_period: f64,
    columns: usize,
    quality: u8,
}

impl Parameters {
    fn declare(node: &Node) -> Result<Self> {
        let count =
            |name: &str, default: i64, (least, most): (i64, i64), text: &str| -> Result<usize> {
                let descriptor = Descriptor::new(text).integers(least, most).read_only();
                // The descriptor keeps it within its bounds.
                Ok(node.declare(name, default, descriptor)?.get() as usize)
            };
        let seed = Descriptor::new("seed of the noise").read_only();
        let period =
            Descriptor::new("time from one camera frame to the next [s], as the model was trained");
        let age = Descriptor::new(
            "greatest age of the newest frame, by when it was received, at which candidates are evaluated [s]",
        );
        Ok(Self {
            context_frames: count(
                "context_frames",
                2,
                (1, 64),
                "observed frames that a prediction starts from",
            )?,
            merging: chunk_merging::declare(node)?,
            settings: EvaluatorSettings {
                max_age: Duration::from_secs_f64(
                    node.declare("max_age", 2.0, age.floats(0.01, 3600.0).read_only())?
                        .get(),
                ),
                horizon: count(
                    "horizon",
                    8,
                    (1, 64),
                    "model steps that are predicted at most",
                )?,
                max_candidates: count(
                    "max_candidates",
                    16,
                    (1, 256),
                    "candidates of one message at most",
                )?,
                // Any 64 bits are a seed.
                seed: node.declare("seed", 0_i64, seed)?.get() as u64,
            },
            integration_steps: count(
                "integration_steps",
                0,
                (0, 1000),
                "Euler steps a predicted frame; 0: what the model was trained for",
            )?,
            frame_period: node
                .declare("frame_period", 0.2, period.floats(1e-3, 60.0).read_only())?
                .get(),
            columns: count(
                "picture_steps",
                2,
                (1, 64),
                "steps of each candidate that the picture shows, the last one among them",
            )?,
            // The descriptor keeps it within 1 to 100.
            quality: count("jpeg_quality", 90, (1, 100), "JPEG quality")? as u8,
        })
    }
}

struct Configured {
    encoder: Arc<Mutex<EncoderStep>>,
    model: Arc<EvaluatorModel>,
    /// None: the model has none, and there are no pictures.
    decoder: Option<Arc<Mutex<Box<dyn Decoder>>>>,
    /// None: the model has none, and there are no probabilities.
    probe: Option<Arc<SuccessClassifier>>,
    history: HistorySettings,
    space: LatentSpace,
    encoding: ActionEncoding,
}

/// An evaluation with the times that its message tells.
type Evaluated = (Result<Evaluation, EvaluatorError>, TimingMessage, Duration);
/// An instruction, and what reading it gave.
type Reading = (String, wm_zoo::Result<Instruction>);
/// By each transport that is used.
type Pictures = (Option<Image>, Option<CompressedImage>);

struct Active {
    goal_images: ImageSubscription,
    latents: Subscription<Latent>,
    actions: Subscription<Action>,
    chunks: Subscription<ActionChunk>,
    candidates: Subscription<ActionCandidates>,
    /// Where there is a probe that reads them.
    instructions: Option<Subscription<Text>>,
    resets: Service<Reset>,
    jumps: watch::Receiver<u64>,
    clock: Clock,
    step: EvaluatorStep,
    waiting: Option<Waiting>,
    assessments: Publisher<Assessment>,
    raws: Option<Publisher<Image>>,
    jpegs: Option<Publisher<CompressedImage>>,
    complaints: Complaints,
    diagnostics: Diagnostics,
    /// Of each the newest is enough: one may wait.
    goals: Work<CameraFrame, Result<Goal, EncoderError>>,
    evaluations: Work<(EvaluationRequest, TimingMessage), Evaluated>,
    pictures: Option<Work<Evaluation, Result<Pictures>>>,
    readings: Option<Work<String, Reading>>,
}

impl Managed for EvaluatorNode {
    type Configured = Configured;
    type Active = Active;
    type Error = anyhow::Error;

    async fn configure(&self) -> Result<Configured> {
        let chosen = self.model.clone();
        let (encoder, model, decoder, probe) = tokio::task::spawn_blocking(move || -> Result<_> {
            let open = chosen.open()?;
            let (encoder, model) = (open.encoder()?, open.predictor()?);
            Ok((encoder, model, open.decoder()?, open.probe()?))
        })
        .await??;
        let probe = probe.map(Arc::new);
        let history = HistorySettings {
            timing: model_choice::timing(self.parameters.frame_period, &model.encoding),
            context_frames: self.parameters.context_frames,
            merging: self.parameters.merging,
        };
        let (space, encoding) = (model.space.clone(), model.encoding.clone());
        tracing::info!("evaluating with {} in latent space {space}", model.name);
        Ok(Configured {
            encoder: Arc::new(Mutex::new(EncoderStep::new(encoder, LatentDtype::F32))),
            model: Arc::new(
                EvaluatorModel::new(model, self.parameters.integration_steps)
                    .with_probe(probe.clone()),
            ),
            probe,
            decoder: decoder.map(|decoder| Arc::new(Mutex::new(decoder))),
            history,
            space,
            encoding,
        })
    }

    fn activate(&self, configured: &Configured) -> Result<Active> {
        let (node, transports) = (&self.node, self.transports);
        let (model, clock) = (Arc::clone(&configured.model), node.clock());
        let evaluations = Work::new(
            1,
            move |(request, timing): (EvaluationRequest, TimingMessage), _| {
                let (started, start) = (Instant::now(), clock.now());
                let evaluated = model.evaluate(&request);
                let timing = TimingMessage {
                    start,
                    end: clock.now(),
                    ..timing
                };
                (evaluated, timing, started.elapsed())
            },
        )
        .on(&self.pool);
        let (columns, quality) = (self.parameters.columns, self.parameters.quality);
        let pictures = configured.decoder.clone().map(|decoder| {
            Work::new(1, move |evaluation: Evaluation, _| {
                let decoder = decoder.lock().unwrap_or_else(PoisonError::into_inner);
                let (picture, header) = picture(&**decoder, &evaluation, columns)?;
                let raw = transports
                    .raw
                    .then(|| encode_image(&picture, header.clone()));
                let jpeg = transports
                    .compressed
                    .then(|| encode_jpeg(&picture, header, quality));
                Ok((raw, jpeg.transpose()?))
            })
            .on(&self.pool)
        });
        let readings = configured.probe.clone().map(|probe| {
            Work::new(1, move |text: String, _| {
                let read = probe.instruction(&text);
                (text, read)
            })
            .on(&self.pool)
        });
        let qos = Qos::best_effort(4);
        let history = History::new(
            configured.history,
            configured.space.clone(),
            configured.encoding.clone(),
            node.now(),
        );
        let latents: Subscription<Latent> = node.subscription("latent", LATENT_QOS)?;
        let input = Input::new("latents", [latents.topic()], "start the encoder");
        node.diagnostics().expect_input(input);
        let instructions = readings
            .is_some()
            .then(|| node.subscription_catching_up(INSTRUCTION, Qos::reliable(1)))
            .transpose()?;
        let (raws, jpegs) = publish_images(node, "candidates/image", transports, qos)?;
        let mut active = Active {
            goal_images: ImageSubscription::catching_up(
                node,
                "goal/image",
                transports,
                Qos::reliable(10),
            )?,
            latents,
            actions: node.subscription("action", Qos::reliable(10))?,
            candidates: node.subscription("action_candidates", Qos::reliable(10))?,
            resets: node.service("~/reset")?,
            jumps: node.clock().jumps(),
            clock: node.clock(),
            chunks: node.subscription("action_chunk", Qos::reliable(10))?,
            step: EvaluatorStep::new(self.parameters.settings, history),
            waiting: None,
            assessments: node.publisher("assessment", Qos::reliable(10))?,
            raws,
            jpegs,
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
            goals: Goal::work(&configured.encoder, &self.pool),
            evaluations,
            pictures,
            instructions,
            readings,
        };
        active.say_probability();
        Ok(active)
    }

    async fn run(&self, active: &mut Active) -> Result<()> {
        loop {
            // Actions before latents, and both before candidates: what is of the same moment may all be there.
            tokio::select! {
                biased;
                finished = active.evaluations.finished() => {
                    active.evaluated(finished.context("the evaluation's thread")?)?;
                }
                finished = finished(&mut active.pictures) => active.pictured(finished.context("the decoder's thread")?)?,
                finished = active.goals.finished() => match finished.context("the goal's thread")? {
                    Ok(goal) => {
                        tracing::info!("goal set: the image of {}", seconds(goal.stamp));
                        active.step.set_goal(goal);
                    }
                    Err(error) => active.complaints.left_out("bad_goal", &format_args!("goal image: {error}")),
                },
                finished = finished(&mut active.readings) => active.read(finished.context("the text tower's thread")?),
                received = received(&mut active.instructions) => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    active.told(&message);
                }
                Some(call) = active.resets.recv() => {
                    let now = active.clock.now();
                    answer_reset(call, |seed| active.step.reset(seed, now));
                },
                Ok(()) = active.jumps.changed() => {
                    if active.step.clock_jumped(active.clock.now()) {
                        tracing::info!("/clock jumped back: history flushed");
                    }
                }
                received = active.goal_images.recv() => {
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
                    active.note(taken);
                    if active.waiting.as_ref().is_some_and(|waiting| !active.step.awaits_frame(&waiting.message)) {
                        active.evaluate_waiting();
                    }
                }
                () = overdue(&active.waiting) => active.evaluate_waiting(),
                received = active.candidates.recv() => {
                    let Some(Received { message, received, .. }) = received else { return Ok(()) };
                    active.evaluate_waiting();
                    if active.step.awaits_frame(&message) {
                        active.wait(message, received);
                    } else {
                        active.evaluate(&message, received);
                    }
                }
            }
        }
    }
}

impl Active {
    fn wait(&mut self, message: ActionCandidates, receive: Time) {
        let period_ns = self.step.timing().frame_period_ns;
        let period = Duration::from_nanos(u64::try_from(period_ns).unwrap_or(0));
        self.waiting = Some(Waiting {
            message,
            receive,
            until: Instant::now() + period,
        });
    }

    fn evaluate_waiting(&mut self) {
        if let Some(Waiting {
            message, receive, ..
        }) = self.waiting.take()
        {
            self.evaluate(&message, receive);
        }
    }

    fn evaluate(&mut self, message: &ActionCandidates, receive: Time) {
        let request = match self
            .step
            .candidates(message, Instant::now(), self.clock.now())
        {
            Ok(request) => request,
            Err(error) => return self.complaints.left_out(error.reason(), &error),
        };
        let timing = TimingMessage {
            capture: Time::from_nanos(request.moment.observed.stamp_ns),
            receive,
            ..TimingMessage::default()
        };
        if let Some((left_out, _)) = self.evaluations.submit((request, timing)) {
            let stamp = seconds(left_out.candidates_stamp);
            self.complaints.left_out(
                "overload",
                &format_args!(
                    "candidates come faster than they are evaluated: those of {stamp} are left out; send fewer, shorter ones \
                     or fewer times a second"
                ),
            );
        }
    }

    fn evaluated(&mut self, (evaluated, timing, taken): Evaluated) -> Result<()> {
        match evaluated {
            Ok(mut evaluation) => {
                self.diagnostics.latency("evaluation").record(taken);
                evaluation.assessment.timing = timing;
                self.assessments.publish(&evaluation.assessment)?;
                let pictures = self.pictures.as_mut();
                if pictures.and_then(|work| work.submit(evaluation)).is_some() {
                    self.complaints.left_out(
                        "overload_pictures",
                        &"candidates come faster than they are decoded",
                    );
                }
            }
            Err(error) => self.complaints.left_out(error.reason(), &error),
        }
        Ok(())
    }

    fn pictured(&mut self, pictures: Result<Pictures>) -> Result<()> {
        match pictures {
            Ok((raw, jpeg)) => {
                if let (Some(raw), Some(raws)) = (raw, &self.raws) {
                    raws.publish(&raw)?;
                }
                if let (Some(jpeg), Some(jpegs)) = (jpeg, &self.jpegs) {
                    jpegs.publish(&jpeg)?;
                }
            }
            Err(error) => self
                .complaints
                .left_out("bad_picture", &format_args!("{error:#}")),
        }
        Ok(())
    }

    fn told(&mut self, message: &Text) {
        let text = self.step.task_mut().take(message);
        if let (Some(text), Some(readings)) = (text, &mut self.readings)
            && readings.submit(text).is_some()
        {
            self.complaints.left_out(
                "superseded_instruction",
                &"a newer instruction came before this one was read",
            );
        }
        self.say_probability();
    }

    fn read(&mut self, (text, read): Reading) {
        if let Err(error) = &read {
            self.complaints.left_out("bad_instruction", error);
        }
        self.step.task_mut().read(text, read);
        self.say_probability();
    }

    /// Says on the node's status what success probabilities are of, or why they are NaN.
    fn say_probability(&mut self) {
        const KEY: &str = "success probability";
        if self.readings.is_some() {
            self.diagnostics.set_value(KEY, self.step.task_mut());
        } else {
            self.diagnostics
                .set_value(KEY, "NaN: the model has no success probe");
        }
    }

    fn note(&mut self, taken: Result<Arrival, HistoryError>) {
        note(&mut self.complaints, taken);
    }
}

/// Candidates whose frame is on its way.
struct Waiting {
    message: ActionCandidates,
    receive: Time,
    /// After this they are evaluated from the newest frame.
    until: Instant,
}

/// Never, where nothing waits.
async fn overdue(waiting: &Option<Waiting>) {
    match waiting {
        Some(waiting) => tokio::time::sleep_until(waiting.until.into()).await,
        None => std::future::pending().await,
    }
}

/// The result of the running job; never, where there is nothing to run.
async fn finished<T: Send + 'static, R: Send + 'static>(
    work: &mut Option<Work<T, R>>,
) -> Result<R, JoinError> {
    match work {
        Some(work) => work.finished().await,
        None => std::future::pending().await,
    }
}

/// The next message; never, where nobody listens.
async fn received<M>(subscription: &mut Option<Subscription<M>>) -> Option<Received<M>>
where
    M: wm_msgs::Message + Send + 'static,
{
    match subscription {
        Some(subscription) => subscription.recv().await,
        None => std::future::pending().await,
    }
}

/// The candidates' pictures in one, and its header: the stamp of the observed frame, as the assessment has it.
fn picture(
    decoder: &dyn Decoder,
    evaluation: &Evaluation,
    columns: usize,
) -> Result<(RgbImage, Header)> {
    let (candidates, horizon, ..) = evaluation.latents.dims5()?;
    let shown = shown_steps(horizon, columns);
    let mut rows = Vec::with_capacity(candidates);
    for candidate in 0..candidates {
        let mut row = Vec::with_capacity(shown.len());
        for step in &shown {
            let latent = evaluation.latents.i((candidate, *step))?.unsqueeze(0)?;
            row.push(to_rgb(&decoder.decode(&latent)?.squeeze(0)?)?);
        }
        rows.push(row);
    }
    let best = usize::try_from(evaluation.assessment.best).ok();
    Ok((tile(&rows, best), evaluation.assessment.header.clone()))
}
