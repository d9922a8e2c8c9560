//! The predictor's ROS interface.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use tokio::time::Interval;
use wm_model::{LatentSpace, WorldModel};
use wm_msgs::{
    std_msgs::String as Text,
    wm_msgs::{Prediction, PredictionError},
};
use wm_ros::{
    Clock, Deadline, Diagnostics, Input, Level, NodeDefinition, Parameter, Publisher, Qos,
    complaints::Complaints, frame_trace,
};
use wm_zoo::ModelFolder;

use super::{
    CalibrationSettings, Doubt, LatentEffect, PredictorSettings, PredictorStep, RolloutRequest,
    RunningRollout,
    ahead::Preparation,
    plots::Plots,
    summary::{Motion, Summary},
    trial::time_of_step,
};
use crate::{
    cadence::{Cadence, OPEN, PACE, SKIPPED, every_nth, hertz, rough},
    chunk_merging::Merging,
    harness::{self, Follower, Inputs, ModelNode, ModelSetup, Outcome},
    history::{HistoryBuilder, seconds},
    paced_work::{Offered, PacedWork},
    pool::Pool,
    work::Stop,
};
use wm_wire::latent_message::LatentDtype;

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Predictor>();

/// Advice for missing inputs and for rollouts that take too long.
const NO_ENCODER: &str = "start the encoder";
const NO_ACTIONS: &str =
    "start the arm's driver, or remap /wm/action to its topic; until then the last action is held";
const SLOW: &str = "observations are dropped; reduce the parameter horizon or integration_steps, or give the predictor \
                    more processor time";
/// Time from one report of a doubt to the next.
const REMINDER: Duration = Duration::from_secs(2);
/// Advice for a higher rate.
const FASTER: &str =
    "for more: a smaller horizon, fewer integration_steps, a smaller model, or a faster processor";

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Number of model steps in a rollout (K).
        horizon: Parameter<i64> = 8, in 1..=64;
        /// Euler steps per predicted frame; 0: the model's own number.
        integration_steps: Parameter<i64> = 0, in 0..=1000;
        /// Number of observed frames that a rollout starts from, one model step apart.
        context_frames: usize = 2, in 1..=64;
        /// Time from one camera frame to the next [s]; 0: as in the model's training.
        frame_period: f64 = 0.0, in 0.0..=60.0;
        /// How overlapping action chunks are merged; weighted: 0.3 of the older and 0.7 of the newer chunk.
        chunk_merging: Merging = "latest";
        /// Seed of the sampler's noise.
        seed: i64 = 0;
        /// Whether the predicted motion away from the last frame is scaled by the factor that fits the last scored
        /// predictions best, for each step of a rollout.
        calibration: bool = true;
        /// Number of scored predictions of each step that the factor is fitted to.
        calibration_window: usize = 50, in 1..=10_000;
        /// Weight of a factor of 1 in the fit, in scored predictions.
        calibration_prior: f64 = 1.0, in 0.0..=1000.0;
        /// The least factor.
        calibration_min: f64 = 0.0, in 0.0..=1.0;
        /// The greatest factor.
        calibration_max: f64 = 1.0, in 1.0..=4.0;
    }
}

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// Inputs about the robot.
        inputs: Inputs;
        /// Predicted latents, one message per model step.
        predictions: Publisher<Prediction> = "predicted", qos(Qos::reliable(16));
        /// Error of a prediction, published when the frame of the predicted time arrives.
        errors: Publisher<PredictionError> = "prediction_error", qos(Qos::reliable(16));
        /// Single numbers, for plots.
        plots: Plots;
        /// Each rollout in one line of words and numbers, to read: its steps, the error ratios, what the arm is assumed
        /// to do, the trust and the latency.
        summaries: Publisher<Text> = "summary", qos(Qos::reliable(16));
    }
}

/// State that the rollout's thread shares with the message loop.
#[derive(Clone)]
struct Shared {
    step: Arc<Mutex<PredictorStep>>,
    model: Arc<WorldModel>,
    preparation: Arc<Preparation>,
    predictions: Publisher<Prediction>,
    errors: Publisher<PredictionError>,
    plots: Plots,
    summaries: Publisher<Text>,
    diagnostics: Diagnostics,
    clock: Clock,
}

/// The loaded parts of the model.
struct Model {
    model: Arc<WorldModel>,
    history: HistoryBuilder,
    /// Computes rollouts. The trial has already used the memory that they need.
    pool: Pool,
    /// The time of a predicted frame in the trial; `None` if the trial failed.
    estimate: Option<Duration>,
}

/// A rollout to make.
struct Job {
    request: RolloutRequest,
    received: Instant,
    /// Time until the next rollout begins.
    limit: Duration,
}

struct Predictor {
    follower: Follower,
    shared: Shared,
    work: PacedWork<Job, Result<()>>,
    /// Euler steps of a rollout. Its duration is proportional to them.
    size: usize,
    /// Unscored predictions that the counters already contain.
    unscored: u64,
    /// Whether the log has warned against trusting the predictions.
    is_doubtful: bool,
    /// Repeats the report of a doubt, because a slow encoder's latents are further apart than a report is valid.
    reminder: Interval,
    complaints: Complaints,
}

impl ModelNode for Predictor {
    const NAME: &'static str = "predictor";
    const ABOUT: &'static str = "Predicts the next latents for the actions that the robot takes.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;

    fn space(model: &Model) -> Option<&LatentSpace> {
        Some(model.history.space())
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let model = folder.world_model()?;
        tracing::info!(
            "predicting with {} in latent space {} on {}",
            model.name,
            model.space,
            model.transition.place()
        );
        let steps = integration_steps(&model, parameters);
        let pool = Pool::foreground(Self::NAME)?;
        let estimate = pool
            .run(|| time_of_step(&model, parameters.context_frames, steps))
            .inspect_err(|error| tracing::warn!("trial prediction failed: {error}"))
            .ok();
        let Parameters {
            frame_period,
            context_frames,
            chunk_merging,
            ..
        } = parameters;
        let history = HistoryBuilder::new(&model, *frame_period, *context_frames, chunk_merging.0);
        if let Some(taken) = estimate {
            let (horizon, gap) = (horizon(parameters), history.timing().frame_period());
            let taken = rollout_time(taken, horizon);
            log_pace(&Cadence::new(gap, Some(taken)), taken, gap, horizon);
        }
        Ok(Model {
            model: Arc::new(model),
            history,
            pool,
            estimate,
        })
    }

    fn activate(at: &ModelSetup<Self>) -> Result<Self> {
        let (node, parameters, model) = (&at.node, &*at.parameters, &at.resources.model);
        let horizon = horizon(parameters);
        let settings = PredictorSettings {
            horizon,
            integration_steps: integration_steps(model, parameters),
            // Any 64 bits are a seed.
            seed: parameters.seed as u64,
            dtype: LatentDtype::F16,
            calibration: calibration(parameters),
        };
        let history = at.resources.history.begin(node.now());
        let step = PredictorStep::new(settings, history);
        let shared = Shared {
            step: Arc::new(Mutex::new(step)),
            model: Arc::clone(model),
            preparation: Arc::default(),
            predictions: at.endpoints.predictions.clone(),
            errors: at.endpoints.errors.clone(),
            plots: at.endpoints.plots.clone(),
            summaries: at.endpoints.summaries.clone(),
            diagnostics: node.diagnostics(),
            clock: node.clock(),
        };
        let estimate = at
            .resources
            .estimate
            .map(|step| rollout_time(step, horizon));
        let cadence = Cadence::new(at.resources.history.timing().frame_period(), estimate);
        shared
            .diagnostics
            .set_value(PACE, every_nth(cadence.nth(), "frame"));
        let (runner, pool) = (shared.clone(), at.resources.pool.clone());
        let work = PacedWork::new(cadence, move |job, stop: &Stop| {
            match pool.run(|| runner.roll_out(job, stop)) {
                Ok(taken) => (Ok(()), taken),
                Err(error) => (Err(error), None),
            }
        });
        let inputs = &at.endpoints.inputs;
        let follower = Follower::new(node, inputs, NO_ENCODER).keeping(at.endpoints.handover());
        let actions = Input::new("actions", [inputs.actions.topic()], NO_ACTIONS);
        node.diagnostics().expect_input(actions.dispensable());
        Ok(Self {
            follower,
            shared,
            work,
            size: horizon * settings.integration_steps,
            unscored: 0,
            is_doubtful: false,
            reminder: tokio::time::interval(REMINDER),
            complaints: Complaints::new(node.diagnostics()),
        })
    }

    fn adopt(&mut self, at: &mut ModelSetup<Self>, model: Model) -> Result<()> {
        at.resources = model;
        let mut new = Self::activate(at)?;
        let now = at.node.now();
        let request = {
            let mut before = self.shared.step();
            let request = new.shared.step().continue_from(&before, now);
            // A rollout of the model before stops.
            before.reset(None, now);
            request
        };
        if let Some(request) = request {
            let job = new.job(request);
            let offered = new.work.offer_again(job);
            new.offered(offered);
        }
        *self = new;
        Ok(())
    }

    async fn run(&mut self, at: &mut ModelSetup<Self>) -> Result<()> {
        let inputs = &mut at.endpoints.inputs;
        loop {
            tokio::select! {
                biased;
                finished = self.work.finished() => {
                    if let Err(error) = finished.context("the rollout's thread")? {
                        self.complaints.left_out("rollout", &format_args!("{error:#}"));
                    }
                    self.report_pace(&at.parameters);
                }
                _ = self.reminder.tick() => {
                    let doubt = self.shared.step().doubt();
                    if matches!(doubt, Some(Doubt::Frozen | Doubt::CameraClock(_))) {
                        self.report_doubt(doubt);
                    }
                }
                event = self.follower.next(inputs) => {
                    let Some(event) = event else { return Ok(()) };
                    let outcome = {
                        let mut step = self.shared.step();
                        let horizon = horizon(&at.parameters);
                        let integration_steps = integration_steps(&self.shared.model, &at.parameters);
                        step.set(horizon, integration_steps);
                        let size = horizon * integration_steps;
                        if size != self.size {
                            // At most 64 times 1000: exact in f64.
                            self.work.cadence.scale(size as f64 / self.size.max(1) as f64);
                            self.size = size;
                        }
                        self.follower.apply(event, &mut *step, &mut self.complaints)
                    };
                    match outcome {
                        Some(Outcome::Latent(effect)) => self.observed(effect)?,
                        Some(Outcome::Chunk(request)) => {
                            let job = self.job(request);
                            let offered = self.work.offer_again(job);
                            self.offered(offered);
                        }
                        None => {}
                    }
                }
            }
        }
    }
}

impl Predictor {
    /// Publishes the errors of predictions of a latent's moment, and starts a rollout or reports why it waits.
    fn observed(&mut self, (errors, rollout): LatentEffect) -> Result<()> {
        let (doubt, trust, unscored) = {
            let step = self.shared.step();
            (step.doubt(), step.trust().into(), step.unscored())
        };
        if unscored > self.unscored {
            self.complaints.left_out_many(
                "unscored",
                unscored - self.unscored,
                &"more predictions wait for their frames than are kept: the oldest are not scored",
            );
            self.unscored = unscored;
        }
        self.report_doubt(doubt);
        match rollout {
            None => {}
            Some(Ok(request)) => {
                let job = self.job(request);
                let (stamp_ns, now) = (job.request.moment.observed.stamp_ns, job.received);
                let offered = self.work.offer(job, stamp_ns, now);
                self.offered(offered);
            }
            Some(Err(wait)) => self.complaints.waiting(wait.kind(), wait.is_usual(), &wait),
        }
        // After the rollout is started, so that it does not wait for them.
        for error in &errors {
            self.shared.scored(error)?;
        }
        self.shared.plots.trust(trust)
    }

    fn job(&self, request: RolloutRequest) -> Job {
        Job {
            request,
            received: Instant::now(),
            limit: self.work.cadence.interval(),
        }
    }

    fn offered(&mut self, offered: Offered<Job>) {
        self.complaints.working("predicting");
        match offered {
            Offered::Taken => {}
            Offered::Skipped => self.shared.diagnostics.count_skipped(SKIPPED, 1),
            Offered::Late(job) => {
                let stamp = seconds(job.request.moment.header_after(0).stamp);
                self.complaints.left_out(
                    "overload",
                    &format_args!(
                        "a rollout takes longer than before or than a camera period: the observation of {stamp} is \
                         dropped"
                    ),
                );
            }
        }
    }

    /// Reports a change of the time between rollouts.
    fn report_pace(&mut self, parameters: &Parameters) {
        let cadence = &mut self.work.cadence;
        let Some((taken, gap)) = cadence.change() else {
            return;
        };
        log_pace(cadence, taken, gap, horizon(parameters));
        let nth = every_nth(cadence.nth(), "frame");
        self.shared.diagnostics.set_value(PACE, nth);
    }

    /// Reports a doubt on `/diagnostics` while it lasts, and in the log when it begins.
    fn report_doubt(&mut self, doubt: Option<Doubt>) {
        if let Some(doubt) = doubt {
            let text = doubt.to_string();
            if !self.is_doubtful {
                tracing::warn!("{text}");
            }
            let level = match doubt {
                Doubt::Frozen | Doubt::CameraClock(_) => Level::Error,
                _ => Level::Warn,
            };
            self.shared.diagnostics.raise("trust", level, text);
        }
        self.is_doubtful = doubt.is_some();
    }
}

impl Shared {
    /// The state stays whole if a thread panics between two messages.
    fn step(&self) -> MutexGuard<'_, PredictorStep> {
        self.step.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn scored(&self, error: &PredictionError) -> Result<()> {
        self.errors.publish(error)?;
        self.plots.scored(error)
    }

    fn summarise(&self, mut summary: Summary) -> Result<()> {
        {
            let step = self.step();
            summary.ratios.clone_from(step.ratios());
            summary.doubt = step.doubt();
        }
        let data = summary.to_string();
        Ok(self.summaries.publish(&Text { data })?)
    }

    /// Computes a rollout, and publishes each step at once. It stops if time jumps or the node becomes inactive.
    /// Returns the time of a complete rollout.
    fn roll_out(&self, job: Job, stop: &Stop) -> Result<Option<Duration>> {
        let Job {
            request,
            received,
            limit,
        } = job;
        let started = Instant::now();
        let observed = request.moment.header_after(0).stamp;
        frame_trace::passed_at(
            "observation received",
            observed,
            request.moment.observed.reception.at,
        );
        frame_trace::passed_at("observation taken", observed, received);
        frame_trace::passed("rollout begun", observed);
        let (prepared, next_ns) = self.preparation.take(request.moment.observed.stamp_ns);
        let space = self.model.encoding.space();
        let mut summary = Summary {
            horizon: 0,
            step_s: request.moment.timing.step_ns() as f64 / 1e9,
            ratios: BTreeMap::new(),
            explained: None,
            // `future` has one action more than the horizon.
            motion: Motion::of(request.future.get(..request.horizon).unwrap_or(&[]), space),
            doubt: None,
            latency_s: None,
        };
        let fits = {
            let observed_ns = request.moment.observed.stamp_ns;
            self.step().fits(request.horizon, observed_ns)
        };
        summary.explained = fits.first().and_then(|fit| fit.explained);
        let rollout = RunningRollout::new(&self.model, request)?
            .taking_over(prepared.as_ref())
            .calibrated(fits.clone());
        for (index, predicted) in rollout.enumerate() {
            let mut predicted = predicted?;
            let step = predicted.prediction.step;
            frame_trace::step_passed("step computed", observed, step);
            if stop.is_asked() || predicted.prediction.epoch != self.step().epoch() {
                return Ok(None);
            }
            predicted.prediction.ready_stamp = self.clock.now();
            let (late, clipped) = (self.step().predicted(&predicted), predicted.clipped);
            let prediction = Arc::new(predicted.prediction);
            self.predictions.publish_shared(Arc::clone(&prediction))?;
            frame_trace::step_passed("step published", observed, step);
            self.plots.predicted(&prediction)?;
            summary.predicted(&prediction);
            if index == 0 {
                self.diagnostics
                    .latency("latent to first step")
                    .record(received.elapsed());
            }
            if clipped > 0 {
                self.diagnostics
                    .count_drops("clipped action values", clipped as u64);
            }
            if let Some(error) = late {
                self.scored(&error)?;
            }
        }
        // After the predictions, so that they do not wait for it.
        self.plots.calibrated(&fits)?;
        self.summarise(summary)?;
        let taken = started.elapsed();
        self.diagnostics.latency("rollout").record(taken);
        let deadline = Deadline {
            stage: "rollout",
            limit,
            advice: SLOW,
        };
        self.diagnostics.took(deadline, taken);
        let ahead = next_ns.and_then(|next_ns| self.step().ahead(next_ns));
        if let Some(ahead) = ahead.filter(|_| !stop.is_asked()) {
            self.preparation.prepare(&self.model, &ahead)?;
        }
        // This includes the preparation of the next rollout, which is shorter by it.
        Ok(Some(started.elapsed()))
    }
}

fn horizon(parameters: &Parameters) -> usize {
    // The range keeps it within 1 to 64.
    parameters.horizon.get() as usize
}

fn integration_steps(model: &WorldModel, parameters: &Parameters) -> usize {
    match parameters.integration_steps.get() {
        0 => model.transition.config().sampler.steps,
        // The range keeps it positive.
        steps => steps as usize,
    }
}

fn calibration(parameters: &Parameters) -> Option<CalibrationSettings> {
    parameters.calibration.then_some(CalibrationSettings {
        window: parameters.calibration_window,
        prior: parameters.calibration_prior,
        bounds: (parameters.calibration_min, parameters.calibration_max),
    })
}

/// The time of a rollout if a predicted frame takes `step`.
fn rollout_time(step: Duration, horizon: usize) -> Duration {
    // At most 64.
    step * horizon as u32
}

/// Logs how often rollouts begin, if frames arrive `gap` apart.
fn log_pace(cadence: &Cadence, taken: Duration, gap: Duration, horizon: usize) {
    let (nth, frames) = (cadence.nth(), every_nth(cadence.nth(), "frame"));
    let (taken, rate) = (rough(taken), hertz(gap));
    let text = format!("one prediction of {horizon} steps takes about {taken} here; at {rate}");
    match nth {
        _ if cadence.is_open() => tracing::info!("{text}, {OPEN}"),
        1 => tracing::info!("{text}, {frames} is used"),
        _ => tracing::warn!("{text}, {frames} is used; {FASTER}"),
    }
}
