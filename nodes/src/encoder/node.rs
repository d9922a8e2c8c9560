//! The encoder on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use wm_ros::{Descriptor, Node, NodeArgs, Qos};

use super::{
    CameraFrame, EncoderStep,
    repeats::{Arrival, Repeats},
};
use crate::{
    complaints::Complaints,
    latent_message::LatentDtype,
    model_choice,
    timeline::seconds,
    transport::{ImageSubscription, Transports},
    work::Work,
};

/// The node's default name.
pub const NAME: &str = "encoder";

/// Frames that may wait for the one that is being encoded.
const WAITING: usize = 1;
/// A camera that is silent for longer is reported.
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
    let model = model_choice::declare(&node)?;
    let descriptor = Descriptor::new("type of the latents' numbers: f32, f16 or bf16").read_only();
    let dtype = node.declare("dtype", "f16".to_owned(), descriptor)?.get();
    let Some(dtype) = LatentDtype::parse(&dtype) else {
        bail!("parameter dtype is \"{dtype}\"; expected f32, f16 or bf16");
    };
    let transports = Transports::declare(&node)?;
    node.seal_parameters()?;

    let encoder = tokio::task::spawn_blocking(move || model.encoder()).await??;
    let step = EncoderStep::new(encoder, dtype);
    tracing::info!("encoding to latent space {}", step.space());
    let step = Arc::new(Mutex::new(step));
    let mut work = Work::new(WAITING, move |(frame, received): (CameraFrame, Instant)| {
        let step = step.lock().unwrap_or_else(PoisonError::into_inner);
        let started = Instant::now();
        let is_raw = matches!(frame, CameraFrame::Raw(_));
        (step.encode(&frame), is_raw, started.elapsed(), received)
    });

    let diagnostics = node.diagnostics();
    let mut complaints = Complaints::new(diagnostics.clone());
    let mut images =
        ImageSubscription::new(&node, "/camera/image_raw", transports, Qos::sensor_data())?;
    for topic in images.topics() {
        diagnostics.expect_input(topic, STALE);
    }
    let latents = node.publisher("latent", Qos::sensor_data())?;
    let mut repeats = Repeats::default();
    loop {
        tokio::select! {
            biased;
            finished = work.finished() => {
                let (latent, is_raw, taken, received) = finished.context("the encoder's thread")?;
                match latent {
                    Ok(latent) => {
                        latents.publish(&latent)?;
                        diagnostics.latency("encode").record(taken);
                        diagnostics.latency("image to latent").record(received.elapsed());
                    }
                    Err(error) => {
                        // the next frames may be good by the other transport
                        repeats.distrust(is_raw);
                        complaints.left_out("bad_image", &error);
                    }
                }
            }
            received = images.recv() => {
                let Some(received) = received else { return Ok(()) };
                let frame = received.message;
                match repeats.arrive(frame.header().stamp, matches!(frame, CameraFrame::Raw(_))) {
                    Arrival::New => {
                        if let Some((late, _)) = work.submit((frame, Instant::now())) {
                            complaints.left_out("overload", &format_args!(
                                "the frame of {} waited when a newer one came: encoding is slower than the camera",
                                seconds(late.header().stamp),
                            ));
                        }
                    }
                    Arrival::OtherTransport => {}
                    Arrival::Duplicate => complaints.left_out(
                        "duplicate",
                        &format_args!("the frame of {} came twice", seconds(frame.header().stamp)),
                    ),
                }
            }
        }
    }
}
