//! The decoder's ROS interface.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use wm_camera::camera_info::info_topic;
use wm_model::{Fit, LatentSpace};
use wm_msgs::{sensor_msgs::CameraInfo, std_msgs::String as Text, wm_msgs::Prediction};
use wm_ros::{
    Diagnostics, Input, Level, NodeDefinition, Parameter, Publisher, Qos, Received, Subscription,
    complaints::Complaints,
};
use wm_zoo::ModelFolder;

use super::{
    DecoderError, DecoderStep,
    camera_view::CameraView,
    rollout_buffer::{RolloutBuffer, WAITING},
    rollouts::{Choice, Rollouts},
};
use crate::{
    cadence::{PACE, SKIPPED, every_nth, measured, rough},
    harness::{self, Handover, KeptMessage, ModelNode, ModelSetup, is_of},
    pool::Pool,
    work::Work,
};
use wm_wire::transport::{ImagePublisher, Pictures, Transports};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Decoder>();

/// If more pictures of the previous rollout wait when a new one begins, the new one is skipped.
const UNFINISHED: usize = WAITING / 4;
/// Pictures of a rollout before the first prediction: the predictor's default horizon.
const USUAL_HORIZON: u32 = 8;
const OVERLOAD: &str = "decoding is slower than the predictions arrive; decode fewer steps (steps) or rollouts (decode_period)";
/// Advice for a higher rate.
const FASTER: &str = "for more: fewer steps, a smaller model, or a faster processor";
const NO_PREDICTOR: &str =
    "start the predictor; it predicts once latents and an action have arrived";
/// Longest message that ROS 2 receives with the default buffers of Linux \[byte\].
const SAFE_BYTES: usize = 98_000;

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Image transport of the pictures.
        image_transport: Transports = "both";
        /// Minimum time between two observations whose rollouts are decoded [s]; 0: decode all. With 0.6 and a camera
        /// at 5 Hz, every third rollout is decoded, with all its steps.
        decode_period: f64 = 0.6, in 0.0..=3600.0;
        /// JPEG quality of the compressed pictures.
        jpeg_quality: Parameter<i64> = 90, in 1..=100;
        /// Steps k to decode, for example [1, 4, 8]; empty: all.
        steps: Parameter<Vec<i64>> = Vec::<i64>::new();
        /// Added to the nice value of the computing threads, as with nice(1). Above 0, other nodes and programs go
        /// first: a picture may be late, a prediction may not.
        nice: i32 = 10, in 0..=19;
    }
}

wm_ros::endpoints! {
    /// Topics.
    struct Endpoints {
        /// Predicted latents.
        predictions: Subscription<Prediction> = "predicted", qos(Qos::best_effort(WAITING));
        /// Predicted pictures, stamped with the predicted time.
        pictures: ImagePublisher = "predicted/image", qos(Qos::reliable(WAITING));
        /// How the camera sees: beside its images, wherever /camera/image_raw is remapped to.
        camera_infos: Subscription<CameraInfo> = "/camera/camera_info", qos(Qos::best_effort(1)), made(|node, _, qos| {
            let images = node.resolve("/camera/image_raw")?;
            node.subscription(&info_topic(&images), qos)
        });
        /// The same for pictures of the size of the predicted ones, with each of them. Not published if camera_info
        /// does not fit the camera's pictures.
        infos: Publisher<CameraInfo> = "predicted/camera_info", qos(Qos::reliable(WAITING));
        /// How a camera picture becomes one of the predicted pictures' size and aspect: stretch, crop or pad.
        fit: Publisher<Text> = "predicted/fit", qos(Qos::latched(1));
    }
}

/// The loaded parts of the model.
struct Model {
    name: String,
    fit: Fit,
    /// `None` if the model has no decoder.
    step: Option<Arc<Mutex<DecoderStep>>>,
    /// `None` if the model has no decoder.
    space: Option<LatentSpace>,
    /// The time of a picture in the trial; `None` if the trial failed.
    estimate: Option<Duration>,
    pool: Pool,
}

/// The pictures of a prediction with their size, or the error, and how long decoding took.
type Decoded = (Result<(Pictures, (u32, u32)), DecoderError>, Duration);

struct Decoder {
    /// `None` if the model has no decoder.
    decoding: Option<Decoding>,
}

struct Decoding {
    work: Work<(Arc<Prediction>, u8), Decoded>,
    rollouts: Rollouts,
    buffer: RolloutBuffer<(Arc<Prediction>, u8)>,
    /// Number of pictures of a rollout.
    pictures: u32,
    /// Pictures since the last measurement, and the sum of their times.
    made: (u32, Duration),
    complaints: Complaints,
    diagnostics: Diagnostics,
}

fn work(
    step: Arc<Mutex<DecoderStep>>,
    transports: Transports,
    pool: &Pool,
) -> Work<(Arc<Prediction>, u8), Decoded> {
    Work::new(
        WAITING,
        move |(prediction, quality): (Arc<Prediction>, u8), _| {
            let step = step.lock().unwrap_or_else(PoisonError::into_inner);
            let started = Instant::now();
            let pictures = step.decode(&prediction).and_then(|picture| {
                let header = prediction.header.clone();
                let pictures = Pictures::encode(&picture, header, transports, quality)?;
                Ok((pictures, picture.dimensions()))
            });
            (pictures, started.elapsed())
        },
    )
    .on(pool)
}

impl Model {
    fn idle(&self) -> String {
        format!("idle: model {} has no decoder", self.name)
    }
}

impl ModelNode for Decoder {
    const NAME: &'static str = "decoder";
    const ABOUT: &'static str = "Decodes predicted latents to pictures.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;

    fn space(model: &Model) -> Option<&LatentSpace> {
        model.space.as_ref()
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let step = folder.decoder()?.map(DecoderStep::new);
        if let Some(step) = &step
            && parameters.image_transport.raw
            && step.raw_bytes() > SAFE_BYTES
        {
            tracing::warn!(
                "raw pictures have {} bytes: a ROS 2 subscriber with default settings loses messages of more than \
                 {SAFE_BYTES} bytes; use image_transport:=compressed, or enlarge the receive buffer on its machine",
                step.raw_bytes(),
            );
        }
        let pool = Pool::background(Decoder::NAME, parameters.nice)?;
        let estimate = step.as_ref().and_then(|step| {
            pool.run(|| measured(|| step.try_out()))
                .inspect_err(|error| tracing::warn!("trial decoding failed: {error}"))
                .ok()
        });
        if let Some(taken) = estimate {
            tracing::info!("decoding a picture takes about {} here", rough(taken));
        }
        let model = Model {
            name: folder.name(),
            fit: folder.fit()?,
            space: step.as_ref().map(|step| step.space().clone()),
            step: step.map(|step| Arc::new(Mutex::new(step))),
            estimate,
            pool,
        };
        if model.step.is_none() {
            tracing::warn!("{}: no pictures will be published", model.idle());
        }
        Ok(model)
    }

    fn activate(at: &ModelSetup<Self>) -> Result<Self> {
        let (parameters, diagnostics) = (&*at.parameters, at.node.diagnostics());
        let Some(step) = &at.resources.step else {
            return Ok(Self { decoding: None });
        };
        let topic = at.endpoints.predictions.topic();
        diagnostics.expect_input(Input::new("predictions", [topic], NO_PREDICTOR));
        Ok(Self {
            decoding: Some(Decoding {
                work: work(
                    Arc::clone(step),
                    parameters.image_transport,
                    &at.resources.pool,
                ),
                // The range keeps it within an hour.
                rollouts: Rollouts::every(
                    (parameters.decode_period * 1e9) as i64,
                    at.resources.estimate.map(|picture| picture * USUAL_HORIZON),
                ),
                buffer: RolloutBuffer::new(),
                pictures: USUAL_HORIZON,
                made: (0, Duration::ZERO),
                complaints: Complaints::new(diagnostics.clone()),
                diagnostics,
            }),
        })
    }

    async fn run(&mut self, at: &mut ModelSetup<Self>) -> Result<()> {
        let handover = at.endpoints.handover();
        let Endpoints {
            predictions,
            pictures,
            camera_infos,
            infos,
            fit: announced,
        } = &mut *at.endpoints;
        let (fit, space) = (at.resources.fit, at.resources.space.as_ref());
        let Some(decoding) = &mut self.decoding else {
            // In `run`, because the lifecycle sets its own status after `activate`.
            at.node
                .diagnostics()
                .set_status(Level::Warn, at.resources.idle());
            while predictions.recv_shared().await.is_some() {}
            return Ok(());
        };
        announced.publish(&Text {
            data: fit.name().to_owned(),
        })?;
        let latency = at.node.diagnostics().latency("decode");
        let mut camera = CameraView::default();
        loop {
            let due = decoding.buffer.due();
            tokio::select! {
                biased;
                finished = decoding.work.finished() => {
                    let (decoded, taken) = finished.context("the decoder's thread")?;
                    match decoded {
                        Ok((decoded, size)) => {
                            if let Some(info) = camera.of(&decoded, size, fit) {
                                infos.publish(&info)?;
                            }
                            pictures.publish(&decoded)?;
                            latency.record(taken);
                            decoding.took(taken);
                        }
                        Err(error) => decoding.complaints.left_out("bad_prediction", &error),
                    }
                }
                received = next(predictions, &handover) => {
                    let Some(received) = received else { return Ok(()) };
                    let is_own = space.is_none_or(|space| is_of(&received.message.latent, space));
                    if !is_own && handover.keep(KeptMessage::Prediction(received.clone())) {
                        continue;
                    }
                    let steps = at.parameters.steps.get();
                    decoding.pictures = pictures_of(received.message.horizon, &steps);
                    if steps.is_empty() || steps.contains(&i64::from(received.message.step)) {
                        // The range keeps it within 1 to 100.
                        let quality = u8::try_from(at.parameters.jpeg_quality.get()).unwrap_or(100);
                        decoding.prediction(received.message, quality, received.at);
                    } else if is_last(&received.message) {
                        decoding.release();
                    }
                }
                Some(received) = camera_infos.recv() => camera.take_info(&at.node, received.message)?,
                Some(frame) = camera.frame() => camera.take_frame(&frame),
                () = until(due) => decoding.release(),
            }
        }
    }
}

/// The next prediction, first those that were kept for the present model; `None` at the shutdown. Cancel safe.
async fn next(
    predictions: &mut Subscription<Prediction>,
    handover: &Handover,
) -> Option<Received<Arc<Prediction>>> {
    match handover.prediction() {
        Some(kept) => Some(kept),
        None => predictions.recv_shared().await,
    }
}

/// Waits until `due`, or forever without one.
async fn until(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due.into()).await,
        None => std::future::pending().await,
    }
}

/// Whether this is the last step of its rollout.
fn is_last(prediction: &Prediction) -> bool {
    prediction.step >= prediction.horizon
}

impl Decoding {
    fn prediction(&mut self, prediction: Arc<Prediction>, quality: u8, now: Instant) {
        let observed_ns = prediction.observed_stamp.to_nanos();
        let is_behind = self.work.waiting() > UNFINISHED;
        match self.rollouts.choose(observed_ns, is_behind, now) {
            Choice::Decode => {
                let rollout = (observed_ns, is_last(&prediction));
                let ready = self.buffer.add((prediction, quality), rollout, now);
                self.submit(ready);
            }
            Choice::Skip => {}
            Choice::Pace => self.diagnostics.count_skipped(SKIPPED, 1),
            Choice::Overload => self.complaints.left_out("overload", &OVERLOAD),
        }
    }

    fn release(&mut self) {
        let predictions = self.buffer.release();
        self.submit(predictions);
    }

    fn submit(&mut self, predictions: Vec<(Arc<Prediction>, u8)>) {
        for job in predictions {
            if self.work.submit(job).is_some() {
                self.complaints.left_out("overload", &OVERLOAD);
            }
        }
    }

    /// Notes the time of a picture, and reports a change of the selection of rollouts. The pictures of a rollout are
    /// measured together, because single ones are too short.
    fn took(&mut self, picture: Duration) {
        self.made.0 += 1;
        self.made.1 += picture;
        if self.made.0 < self.pictures {
            return;
        }
        let (_, taken) = std::mem::take(&mut self.made);
        self.rollouts.took(taken);
        let cadence = self.rollouts.cadence();
        if let Some((taken, gap)) = cadence.change() {
            let (nth, pictures) = (every_nth(cadence.nth(), "rollout"), self.pictures);
            let text = format!(
                "the {pictures} pictures of a rollout take about {} here: of one every {}, {nth} is decoded",
                rough(taken),
                rough(gap)
            );
            match cadence.nth() {
                1 => tracing::info!("{text}"),
                _ => tracing::warn!("{text}; {FASTER}"),
            }
            self.diagnostics.set_value(PACE, nth);
        }
    }
}

/// Number of pictures of a rollout if `steps` are decoded; empty: all.
fn pictures_of(horizon: u32, steps: &[i64]) -> u32 {
    if steps.is_empty() {
        return horizon;
    }
    let within = |step: &&i64| (1..=i64::from(horizon)).contains(*step);
    // At most the horizon.
    steps.iter().filter(within).count() as u32
}
