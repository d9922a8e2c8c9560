//! The decoder on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::Instant,
};

use anyhow::{Context as _, Result};
use wm_msgs::wm_msgs::Prediction;
use wm_ros::{Descriptor, Node, NodeArgs, Qos};

use super::{
    DecoderStep, jpeg_message, raw_message,
    rollouts::{Choice, Rollouts},
};
use crate::{complaints::Complaints, model_choice, transport::Transports, work::Work};

/// The node's default name.
pub const NAME: &str = "decoder";

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
    wm_ros::run(NAME, crate::NAMESPACE, args, body)
}

/// The node itself, in a process that may hold others.
///
/// # Errors
/// As [`run`].
pub async fn body(node: Node) -> Result<()> {
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
    // The descriptor keeps it within an hour.
    let mut rollouts = Rollouts::every((period * 1e9) as i64);
    node.seal_parameters()?;

    let decoder = tokio::task::spawn_blocking(move || model.decoder()).await??;
    let step = DecoderStep::new(decoder);
    if transports.raw && step.raw_bytes() > SAFE_BYTES {
        tracing::warn!(
            "raw pictures of {} bytes: a stock ROS 2 subscriber loses messages beyond {SAFE_BYTES} bytes; use \
             image_transport:=compressed, or give it a larger receive buffer",
            step.raw_bytes(),
        );
    }
    let step = Arc::new(Mutex::new(step));
    let mut work = Work::new(WAITING, move |(prediction, quality): (Prediction, u8)| {
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
    });

    let diagnostics = node.diagnostics();
    let mut complaints = Complaints::new(diagnostics.clone());
    let mut predictions =
        node.subscription::<Prediction>("predicted", Qos::best_effort(WAITING))?;
    let qos = Qos::best_effort(WAITING);
    let raws = transports
        .raw
        .then(|| node.publisher("predicted/image", qos))
        .transpose()?;
    let jpegs = transports
        .compressed
        .then(|| node.publisher("predicted/image/compressed", qos))
        .transpose()?;
    loop {
        tokio::select! {
            biased;
            finished = work.finished() => {
                let (messages, taken) = finished.context("the decoder's thread")?;
                match messages {
                    Ok((raw, jpeg)) => {
                        if let (Some(raw), Some(raws)) = (raw, &raws) {
                            raws.publish(&raw)?;
                        }
                        if let (Some(jpeg), Some(jpegs)) = (jpeg, &jpegs) {
                            jpegs.publish(&jpeg)?;
                        }
                        diagnostics.latency("decode").record(taken);
                    }
                    Err(error) => complaints.left_out("bad_prediction", &error),
                }
            }
            received = predictions.recv() => {
                let Some(received) = received else { return Ok(()) };
                let steps = steps.get();
                if !steps.is_empty() && !steps.contains(&i64::from(received.message.step)) {
                    continue;
                }
                let observed_ns = received.message.observed_stamp.to_nanos();
                match rollouts.choose(observed_ns, work.waiting() > UNFINISHED) {
                    Choice::Decode => {}
                    Choice::Skip => continue,
                    Choice::Overload => {
                        complaints.left_out("overload", &OVERLOAD);
                        continue;
                    }
                }
                // The descriptor keeps it within 1 to 100.
                let quality = u8::try_from(quality.get()).unwrap_or(100);
                if work.submit((received.message, quality)).is_some() {
                    complaints.left_out("overload", &OVERLOAD);
                }
            }
        }
    }
}
