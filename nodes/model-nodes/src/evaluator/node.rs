//! The evaluator's ROS interface.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use image::RgbImage;
use tokio::task::JoinError;
use wm_model::{Decoder, LatentSpace};
use wm_msgs::{
    builtin_interfaces::Time,
    std_msgs::{Header, String as Text},
    wm_msgs::{ActionCandidates, Assessment, Timing as TimingMessage},
};
use wm_ros::{
    Clock, Diagnostics, Node, NodeDefinition, Publisher, Qos, Received, Subscription,
    complaints::Complaints,
};
use wm_zoo::ModelFolder;
use wm_zoo::success_probe::{Instruction, SuccessClassifier};

use super::{
    Evaluation, EvaluationRequest, EvaluatorError, EvaluatorModel, EvaluatorSettings,
    EvaluatorStep, shown_steps, tile,
};
use crate::{
    cadence::{Cadence, Load, SKIPPED, rough},
    chunk_merging::Merging,
    encoder::EncoderStep,
    env::INSTRUCTION,
    harness::{
        self, Follower, GoalInputs, Goals, Inputs, ModelNode, ModelSetup, OTHER_SPACE, Outcome,
    },
    history::{HistoryBuilder, seconds},
    planner::GoalReader,
    pool::Pool,
    work::Work,
};
use wm_wire::{
    latent_message::LatentDtype,
    transport::{ImagePublisher, Pictures, Transports},
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Evaluator>();

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Image transport of the goal and of the picture of the candidates.
        image_transport: Transports = "both";
        /// Maximum number of predicted model steps; no more than the shortest candidate has.
        horizon: usize = 8, in 1..=64;
        /// Maximum number of candidates in a message.
        max_candidates: usize = 16, in 1..=256;
        /// Number of observed frames that a prediction starts from, one model step apart.
        context_frames: usize = 2, in 1..=64;
        /// Euler steps per predicted frame; 0: the model's own number.
        integration_steps: usize = 0, in 0..=1000;
        /// Time from one camera frame to the next [s]; 0: as in the model's training.
        frame_period: f64 = 0.0, in 0.0..=60.0;
        /// Maximum time since the newest frame was received [s]. After that, candidates are not evaluated.
        max_age: Duration = 2.0, in 0.01..=3600.0;
        /// How overlapping action chunks are merged; weighted: 0.3 of the older and 0.7 of the newer chunk.
        chunk_merging: Merging = "latest";
        /// Seed of the noise. All candidates share the noise.
        seed: i64 = 0;
        /// Number of steps of each candidate in the picture, including the last one.
        picture_steps: usize = 2, in 1..=64;
        /// JPEG quality of the picture.
        jpeg_quality: u8 = 90, in 1..=100;
        /// Added to the nice value of the computing threads, as with nice(1). Above 0, other nodes and programs go
        /// first: an assessment may be later than a prediction.
        nice: i32 = 10, in 0..=19;
    }
}

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// Inputs about the robot.
        inputs: Inputs;
        /// A policy's candidate chunks.
        candidates: Subscription<ActionCandidates> = "action_candidates";
        /// What says what to reach; costs are distances to the last of its pictures.
        goals: GoalInputs;
        /// The task in words, volatile or latched, for the success probe if the model has one.
        instructions: Subscription<Text> = INSTRUCTION, qos(Qos::reliable(1)), made(Node::subscription_catching_up);
        /// What each candidate would do.
        assessments: Publisher<Assessment> = "assessment";
        /// The candidates' predicted pictures, one row per candidate.
        pictures: ImagePublisher = "candidates/image", qos(Qos::reliable(4));
    }
}

/// The loaded parts of the model.
struct Model {
    goals: GoalReader,
    evaluator: Arc<EvaluatorModel>,
    /// `None` if the model has no decoder. Then no pictures are published.
    decoder: Option<Arc<Mutex<Box<dyn Decoder>>>>,
    /// `None` if the model has no success probe. Then probabilities are NaN.
    probe: Option<Arc<SuccessClassifier>>,
    history: HistoryBuilder,
    pool: Pool,
}

/// An evaluation, the times in its message, and its duration.
type Evaluated = (Result<Evaluation, EvaluatorError>, TimingMessage, Duration);
/// An instruction, and its encoding.
type Reading = (String, wm_zoo::Result<Instruction>);

struct Evaluator {
    follower: Follower,
    step: EvaluatorStep,
    clock: Clock,
    waiting: Option<Waiting>,
    complaints: Complaints,
    diagnostics: Diagnostics,
    goals: Goals,
    /// Evaluates candidates. Only the newest message counts, so one may wait.
    evaluations: Work<(EvaluationRequest, TimingMessage), Evaluated>,
    /// Measures whether candidates arrive faster than they are evaluated.
    cadence: Cadence,
    pictures: Option<Work<Evaluation, Result<Pictures>>>,
    /// Encodes instructions; `None` without a success probe.
    readings: Option<Work<String, Reading>>,
}

impl ModelNode for Evaluator {
    const NAME: &'static str = "evaluator";
    const ABOUT: &'static str =
        "Predicts and scores what each candidate chunk of a policy would do.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;

    fn space(model: &Model) -> Option<&LatentSpace> {
        Some(model.history.space())
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let encoder = EncoderStep::of_model(&folder, LatentDtype::F32)?;
        let model = folder.world_model()?;
        let (decoder, probe) = (folder.decoder()?, folder.probe()?.map(Arc::new));
        let Parameters {
            frame_period,
            context_frames,
            chunk_merging,
            ..
        } = parameters;
        let history = HistoryBuilder::new(&model, *frame_period, *context_frames, chunk_merging.0);
        let (name, space, place) = (&model.name, &model.space, model.transition.place());
        tracing::info!("evaluating with {name} in latent space {space} on {place}");
        let evaluator =
            EvaluatorModel::new(model, parameters.integration_steps).with_probe(probe.clone());
        Ok(Model {
            goals: GoalReader::new(encoder),
            evaluator: Arc::new(evaluator),
            decoder: decoder.map(|decoder| Arc::new(Mutex::new(decoder))),
            probe,
            history,
            pool: Pool::background(Evaluator::NAME, parameters.nice)?,
        })
    }

    fn activate(at: &ModelSetup<Self>) -> Result<Self> {
        let (node, parameters, model) = (&at.node, &*at.parameters, &at.resources);
        let (evaluator, clock) = (Arc::clone(&model.evaluator), node.clock());
        let evaluations = Work::new(
            1,
            move |(request, timing): (EvaluationRequest, TimingMessage), _| {
                let (started, start) = (Instant::now(), clock.now());
                let evaluated = evaluator.evaluate(&request);
                let timing = TimingMessage {
                    start,
                    end: clock.now(),
                    ..timing
                };
                (evaluated, timing, started.elapsed())
            },
        )
        .on(&model.pool);
        let (columns, quality) = (parameters.picture_steps, parameters.jpeg_quality);
        let transports = parameters.image_transport;
        let pictures = model.decoder.clone().map(|decoder| {
            Work::new(1, move |evaluation: Evaluation, _| {
                let decoder = decoder.lock().unwrap_or_else(PoisonError::into_inner);
                let (picture, header) = picture(&**decoder, &evaluation, columns)?;
                Ok(Pictures::encode(&picture, header, transports, quality)?)
            })
            .on(&model.pool)
        });
        let readings = model.probe.clone().map(|probe| {
            Work::new(1, move |text: String, _| {
                let read = probe.instruction(&text);
                (text, read)
            })
            .on(&model.pool)
        });
        let settings = EvaluatorSettings {
            max_age: parameters.max_age,
            horizon: parameters.horizon,
            max_candidates: parameters.max_candidates,
            // Any 64 bits are a seed.
            seed: parameters.seed as u64,
        };
        let history = model.history.begin(node.now());
        let mut evaluator = Self {
            follower: Follower::new(node, &at.endpoints.inputs, "start the encoder")
                .keeping(at.endpoints.handover()),
            step: EvaluatorStep::new(settings, history),
            clock: node.clock(),
            waiting: None,
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
            goals: Goals::new(model.goals.clone(), &model.pool, parameters.follows_model()),
            evaluations,
            cadence: Cadence::new(model.history.timing().frame_period(), None),
            pictures,
            readings,
        };
        evaluator.report_probability();
        Ok(evaluator)
    }

    fn adopt(&mut self, at: &mut ModelSetup<Self>, model: Model) -> Result<()> {
        at.resources = model;
        let mut new = Self::activate(at)?;
        let is_same = new.step.continue_from(&self.step, at.node.now());
        let has_goal = self.step.has_goal();
        if !new.goals.continue_from(&self.goals, has_goal, is_same) {
            self.complaints
                .left_out("goal_of_other_space", &OTHER_SPACE);
        }
        let data = self.step.task_mut().text().to_owned();
        if !data.is_empty() {
            new.instruction(&Text { data });
        }
        *self = new;
        Ok(())
    }

    async fn run(&mut self, at: &mut ModelSetup<Self>) -> Result<()> {
        let Endpoints {
            inputs,
            candidates,
            goals,
            instructions,
            assessments,
            pictures,
        } = &mut *at.endpoints;
        loop {
            // Candidates last: if messages of the same moment wait together, candidates need the others.
            tokio::select! {
                biased;
                finished = self.evaluations.finished() => {
                    self.evaluated(finished.context("the evaluation's thread")?, assessments)?;
                }
                finished = finished(&mut self.pictures) => match finished.context("the decoder's thread")? {
                    Ok(made) => pictures.publish(&made)?,
                    Err(error) => self.complaints.left_out("bad_picture", &format_args!("{error:#}")),
                },
                finished = finished(&mut self.readings) => self.read(finished.context("the text tower's thread")?),
                goal = self.goals.next(goals, &mut self.complaints) => {
                    let Some(goal) = goal? else { return Ok(()) };
                    self.step.set_goal(goal);
                }
                received = instructions.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(()) };
                    self.instruction(&message);
                }
                event = self.follower.next(inputs) => {
                    let Some(event) = event else { return Ok(()) };
                    let outcome = self.follower.apply(event, &mut self.step, &mut self.complaints);
                    let has_its_frame = |waiting: &Waiting| !self.step.awaits_frame(&waiting.message);
                    if matches!(outcome, Some(Outcome::Latent(()))) && self.waiting.as_ref().is_some_and(has_its_frame) {
                        self.evaluate_waiting();
                    }
                }
                () = overdue(&self.waiting) => self.evaluate_waiting(),
                received = candidates.recv() => {
                    let Some(Received { message, received, .. }) = received else { return Ok(()) };
                    self.evaluate_waiting();
                    if self.step.awaits_frame(&message) {
                        self.wait(message, received);
                    } else {
                        self.evaluate(&message, received);
                    }
                }
            }
        }
    }
}

impl Evaluator {
    fn wait(&mut self, message: ActionCandidates, receive: Time) {
        let period_ns = self.step.timing().frame_period_ns;
        // A period is positive.
        let period = Duration::from_nanos(period_ns.unsigned_abs());
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
        // An idle evaluator evaluates every message, because a policy waits for it. During an evaluation, the newest
        // message waits. The cadence only decides whether replaced messages count as skipped or as dropped.
        let (stamp_ns, now) = (request.candidates_stamp.to_nanos(), Instant::now());
        self.cadence.arrived(stamp_ns, now, Load::Idle);
        let left_out = self.evaluations.submit((request, timing));
        if self.cadence.nth() > 1 {
            let number = u64::from(left_out.is_some());
            self.diagnostics.count_skipped(SKIPPED, number);
        } else if let Some((left_out, _)) = left_out {
            let stamp = seconds(left_out.candidates_stamp);
            self.complaints.left_out(
                "overload",
                &format_args!(
                    "candidates arrive faster than they are evaluated: those of {stamp} are dropped; send fewer or \
                     shorter candidates, or send them less often"
                ),
            );
        }
    }

    fn evaluated(
        &mut self,
        (evaluated, timing, taken): Evaluated,
        assessments: &Publisher<Assessment>,
    ) -> Result<()> {
        match evaluated {
            Ok(mut evaluation) => {
                self.diagnostics.latency("evaluation").record(taken);
                self.took(taken);
                evaluation.assessment.timing = timing;
                assessments.publish(&evaluation.assessment)?;
                let pictures = self.pictures.as_mut();
                if pictures.and_then(|work| work.submit(evaluation)).is_some() {
                    self.complaints.left_out(
                        "overload_pictures",
                        &"candidates arrive faster than they are decoded",
                    );
                }
            }
            Err(error) => self.complaints.left_out(error.reason(), &error),
        }
        Ok(())
    }

    /// Notes the duration of an evaluation, and reports if it becomes longer than the time between candidates.
    fn took(&mut self, taken: Duration) {
        self.cadence.took(taken);
        let Some((taken, gap)) = self.cadence.change() else {
            return;
        };
        let (taken, gap) = (rough(taken), rough(gap));
        let text =
            format!("an evaluation takes about {taken} here, and candidates come every {gap}");
        match self.cadence.nth() {
            1 => tracing::info!("{text}: all are evaluated"),
            _ => tracing::warn!(
                "{text}: the newest are evaluated; for more: fewer or shorter candidates, fewer integration_steps, a \
                 smaller model, or a faster processor"
            ),
        }
    }

    fn instruction(&mut self, message: &Text) {
        let Some(readings) = &mut self.readings else {
            return;
        };
        let text = self.step.task_mut().take(message);
        if let Some(text) = text
            && readings.submit(text).is_some()
        {
            self.complaints.left_out(
                "superseded_instruction",
                &"a newer instruction arrived before this one was encoded",
            );
        }
        self.report_probability();
    }

    fn read(&mut self, (text, read): Reading) {
        if let Err(error) = &read {
            self.complaints.left_out("bad_instruction", error);
        }
        self.step.task_mut().read(text, read);
        self.report_probability();
    }

    /// Reports on `/diagnostics` the instruction of the success probabilities, or why they are NaN.
    fn report_probability(&mut self) {
        const KEY: &str = "success probability";
        if self.readings.is_some() {
            self.diagnostics.set_value(KEY, self.step.task_mut());
        } else {
            self.diagnostics
                .set_value(KEY, "NaN: the model has no success probe");
        }
    }
}

/// Candidates that wait for their frame.
struct Waiting {
    message: ActionCandidates,
    receive: Time,
    /// After this moment, they are evaluated from the newest frame.
    until: Instant,
}

/// Waits until the candidates are due, or forever without any.
async fn overdue(waiting: &Option<Waiting>) {
    match waiting {
        Some(waiting) => tokio::time::sleep_until(waiting.until.into()).await,
        None => std::future::pending().await,
    }
}

/// The result of the running job; pending without a `work`.
async fn finished<T: Send + 'static, R: Send + 'static>(
    work: &mut Option<Work<T, R>>,
) -> Result<R, JoinError> {
    match work {
        Some(work) => work.finished().await,
        None => std::future::pending().await,
    }
}

/// All pictures of the candidates in one, and its header: that of the assessment, with the stamp of the observed frame.
fn picture(
    decoder: &dyn Decoder,
    evaluation: &Evaluation,
    columns: usize,
) -> Result<(RgbImage, Header)> {
    let shown = shown_steps(evaluation.latents.len(), columns);
    let mut rows = Vec::new();
    for candidate in 0..evaluation.assessment.candidates.len() {
        let latents = shown
            .iter()
            .filter_map(|step| evaluation.latents.get(*step));
        let latents = latents.filter_map(|of_step| of_step.get(candidate));
        let row = latents.map(|latent| decoder.picture(latent));
        rows.push(row.collect::<wm_model::Result<Vec<_>>>()?);
    }
    let best = usize::try_from(evaluation.assessment.best).ok();
    Ok((tile(&rows, best), evaluation.assessment.header.clone()))
}
