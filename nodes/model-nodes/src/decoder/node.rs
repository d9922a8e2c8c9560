//! The decoder on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use wm_msgs::{
    sensor_msgs::{CompressedImage, Image},
    wm_msgs::Prediction,
};
use wm_ros::{
    Descriptor, Diagnostics, Input, Level, Lifecycle, Managed, Node, NodeArgs, Parameter,
    Publisher, Qos, Subscription,
};

use super::{
    DecoderError, DecoderStep, jpeg_message, raw_message,
    rollouts::{Choice, Rollouts},
};
use crate::{
    model_choice::{self, ModelChoice},
    pool::Pool,
    work::Work,
};
use wm_ros::complaints::Complaints;
use wm_wire::transport::{Transports, publish_images};

/// The node's default name.
pub const NAME: &str = "decoder";
/// Where processors are short, a picture may come later than a prediction.
const NICE: i64 = 5;

/// Predictions that may wait: two rollouts of eight, since they come faster than one by one.
const WAITING: usize = 16;
/// Pictures of the rollout before that may wait when a new one begins: a hiccup is no reason to leave it out.
const UNFINISHED: usize = WAITING / 4;
const OVERLOAD: &str =
    "decoding is slower than the predictions come; decode fewer steps or rollouts";
/// What a stock ROS 2 machine receives without a larger buffer \[byte\].
const SAFE_BYTES: usize = 98_000;

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
    let descriptor = Descriptor::new("JPEG quality").integers(1, 100);
    let quality = node.declare("jpeg_quality", 90_i64, descriptor)?;
    let descriptor = Descriptor::new("steps k that are decoded; empty: all");
    let steps = node.declare("steps", Vec::<i64>::new(), descriptor)?;
    let descriptor = Descriptor::new(
        "least time between two observations whose rollouts are decoded [s]; 0: all",
    )
    .floats(0.0, 3600.0)
    .read_only();
    let period = node.declare("decode_period", 0.6_f64, descriptor)?.get();
    let pool = Pool::declare(&node, NICE)?;
    node.seal_parameters()?;
    let decoder = DecoderNode {
        node,
        model,
        transports,
        quality,
        steps,
        // The descriptor keeps it within an hour.
        period_ns: (period * 1e9) as i64,
        pool,
    };
    lifecycle.run(decoder).await
}

struct DecoderNode {
    node: Node,
    model: ModelChoice,
    transports: Transports,
    quality: Parameter<i64>,
    steps: Parameter<Vec<i64>>,
    /// Least time between two observations whose rollouts are decoded \[ns\].
    period_ns: i64,
    pool: Pool,
}

/// The pictures of a prediction, or why there are none, and how long it took.
type Decoded = (Result<Pictures, DecoderError>, Duration);
/// By each transport that is used.
type Pictures = (Option<Image>, Option<CompressedImage>);

struct Active {
    /// `None` where the model has no decoder.
    decoding: Option<Decoding>,
    raws: Option<Publisher<Image>>,
    jpegs: Option<Publisher<CompressedImage>>,
    diagnostics: Diagnostics,
}

struct Decoding {
    predictions: Subscription<Prediction>,
    work: Work<(Prediction, u8), Decoded>,
    rollouts: Rollouts,
    complaints: Complaints,
}

fn work(
    step: Arc<Mutex<DecoderStep>>,
    transports: Transports,
    pool: &Pool,
) -> Work<(Prediction, u8), Decoded> {
    Work::new(
        WAITING,
        move |(prediction, quality): (Prediction, u8), _| {
            let step = step.lock().unwrap_or_else(PoisonError::into_inner);
            let started = Instant::now();
            let messages = step.decode(&prediction).and_then(|picture| {
                let raw = transports.raw.then(|| raw_message(&picture, &prediction));
                let jpeg = transports
                    .compressed
                    .then(|| jpeg_message(&picture, &prediction, quality));
                Ok((raw, jpeg.transpose()?))
            });
            (messages, started.elapsed())
        },
    )
    .on(pool)
}

impl DecoderNode {
    fn idle(&self) -> String {
        format!("idle: model {} has no decoder", self.model.name())
    }
}

impl Managed for DecoderNode {
    type Configured = Option<Arc<Mutex<DecoderStep>>>;
    type Active = Active;
    type Error = anyhow::Error;

    async fn configure(&self) -> Result<Self::Configured> {
        let model = self.model.clone();
        let decoder = tokio::task::spawn_blocking(move || model.open()?.decoder()).await??;
        let Some(decoder) = decoder else {
            tracing::warn!("{}: there will be no pictures", self.idle());
            return Ok(None);
        };
        let step = DecoderStep::new(decoder);
        if self.transports.raw && step.raw_bytes() > SAFE_BYTES {
            tracing::warn!(
                "raw pictures of {} bytes: a stock ROS 2 subscriber loses messages beyond {SAFE_BYTES} bytes; use \
                 image_transport:=compressed, or give it a larger receive buffer",
                step.raw_bytes(),
            );
        }
        Ok(Some(Arc::new(Mutex::new(step))))
    }

    fn activate(&self, step: &Self::Configured) -> Result<Active> {
        let (node, qos) = (&self.node, Qos::best_effort(WAITING));
        let transports = self.transports;
        let decoding = match step {
            None => None,
            Some(step) => Some(Decoding {
                predictions: predictions(node, qos)?,
                work: work(Arc::clone(step), transports, &self.pool),
                rollouts: Rollouts::every(self.period_ns),
                complaints: Complaints::new(node.diagnostics()),
            }),
        };
        let (raws, jpegs) = publish_images(node, "predicted/image", transports, qos)?;
        Ok(Active {
            decoding,
            // Announced by an idle node, too: who waits for its topics is not to wait for ever.
            raws,
            jpegs,
            diagnostics: node.diagnostics(),
        })
    }

    async fn run(&self, active: &mut Active) -> Result<()> {
        let Some(mut decoding) = active.decoding.take() else {
            active.diagnostics.set_status(Level::Warn, self.idle());
            self.node.shutdown().wait().await;
            return Ok(());
        };
        loop {
            tokio::select! {
                biased;
                finished = decoding.work.finished() => {
                    let (messages, taken) = finished.context("the decoder's thread")?;
                    match messages {
                        Ok(pictures) => active.decoded(pictures, taken)?,
                        Err(error) => decoding.complaints.left_out("bad_prediction", &error),
                    }
                }
                received = decoding.predictions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let steps = self.steps.get();
                    if steps.is_empty() || steps.contains(&i64::from(received.message.step)) {
                        // The descriptor keeps it within 1 to 100.
                        let quality = u8::try_from(self.quality.get()).unwrap_or(100);
                        decoding.prediction(received.message, quality);
                    }
                }
            }
        }
    }
}

/// Subscribes to the predictions, which are missed where they do not come.
fn predictions(node: &Node, qos: Qos) -> Result<Subscription<Prediction>> {
    let predictions: Subscription<Prediction> = node.subscription("predicted", qos)?;
    let input = Input::new(
        "predictions",
        [predictions.topic()],
        "start the predictor, which predicts when latents and an action have come",
    );
    node.diagnostics().expect_input(input);
    Ok(predictions)
}

impl Active {
    fn decoded(&mut self, (raw, jpeg): Pictures, taken: Duration) -> Result<()> {
        if let (Some(raw), Some(raws)) = (raw, &self.raws) {
            raws.publish(&raw)?;
        }
        if let (Some(jpeg), Some(jpegs)) = (jpeg, &self.jpegs) {
            jpegs.publish(&jpeg)?;
        }
        self.diagnostics.latency("decode").record(taken);
        Ok(())
    }
}

impl Decoding {
    fn prediction(&mut self, prediction: Prediction, quality: u8) {
        let observed_ns = prediction.observed_stamp.to_nanos();
        let is_behind = self.work.waiting() > UNFINISHED;
        match self.rollouts.choose(observed_ns, is_behind) {
            Choice::Decode => {
                if self.work.submit((prediction, quality)).is_some() {
                    self.complaints.left_out("overload", &OVERLOAD);
                }
            }
            Choice::Skip => {}
            Choice::Overload => self.complaints.left_out("overload", &OVERLOAD),
        }
    }
}
