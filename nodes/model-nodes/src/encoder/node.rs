//! The encoder on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use wm_msgs::wm_msgs::Latent;
use wm_ros::{Descriptor, Diagnostics, Input, Lifecycle, Managed, Node, NodeArgs, Publisher, Qos};

use super::{
    EncoderError, EncoderStep,
    repeats::{Arrival, Repeats},
};
use crate::{
    history::seconds,
    model_choice::{self, ModelChoice},
    work::Work,
};
use wm_ros::complaints::Complaints;
use wm_wire::{
    camera_frame::CameraFrame,
    latent_message::{LATENT_QOS, LatentDtype},
    transport::{ImageSubscription, Transports},
};

/// The node's default name.
pub const NAME: &str = "encoder";

/// Frames that may wait for the one that is being encoded.
const WAITING: usize = 1;
/// What to do where there is no camera.
const NO_CAMERA: &str = "start the camera's driver, or remap /camera/image_raw to its topic";

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
    let descriptor = Descriptor::new("type of the latents' numbers: f32, f16 or bf16").read_only();
    let dtype = node.declare("dtype", "f16".to_owned(), descriptor)?.get();
    let Some(dtype) = LatentDtype::parse(&dtype) else {
        bail!("parameter dtype is \"{dtype}\"; expected f32, f16 or bf16");
    };
    let transports = Transports::declare(&node)?;
    node.seal_parameters()?;
    let encoder = EncoderNode {
        node,
        model,
        dtype,
        transports,
    };
    lifecycle.run(encoder).await
}

struct EncoderNode {
    node: Node,
    model: ModelChoice,
    dtype: LatentDtype,
    transports: Transports,
}

/// An encoded frame or why there is none, whether it came raw, how long it took, and when it came.
type Encoded = (Result<Latent, EncoderError>, bool, Duration, Instant);

struct Active {
    images: ImageSubscription,
    latents: Publisher<Latent>,
    work: Work<(CameraFrame, Instant), Encoded>,
    repeats: Repeats,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl Managed for EncoderNode {
    type Configured = Arc<Mutex<EncoderStep>>;
    type Active = Active;
    type Error = anyhow::Error;

    async fn configure(&self) -> Result<Self::Configured> {
        let model = self.model.clone();
        let encoder = tokio::task::spawn_blocking(move || model.open()?.encoder()).await??;
        let step = EncoderStep::new(encoder, self.dtype);
        tracing::info!("encoding to latent space {}", step.space());
        Ok(Arc::new(Mutex::new(step)))
    }

    fn activate(&self, step: &Self::Configured) -> Result<Active> {
        let step = Arc::clone(step);
        let work = Work::new(
            WAITING,
            move |(frame, received): (CameraFrame, Instant), _| {
                let step = step.lock().unwrap_or_else(PoisonError::into_inner);
                let started = Instant::now();
                let is_raw = matches!(frame, CameraFrame::Raw(_));
                (step.encode(&frame), is_raw, started.elapsed(), received)
            },
        );
        let diagnostics = self.node.diagnostics();
        let camera = "/camera/image_raw";
        let images =
            ImageSubscription::new(&self.node, camera, self.transports, Qos::sensor_data())?;
        diagnostics.expect_input(Input::new("camera images", images.topics(), NO_CAMERA));
        Ok(Active {
            images,
            latents: self.node.publisher("latent", LATENT_QOS)?,
            work,
            repeats: Repeats::default(),
            complaints: Complaints::new(diagnostics.clone()),
            diagnostics,
        })
    }

    async fn run(&self, active: &mut Active) -> Result<()> {
        loop {
            tokio::select! {
                biased;
                finished = active.work.finished() => active.encoded(finished.context("the encoder's thread")?)?,
                received = active.images.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    active.frame(received.message);
                }
            }
        }
    }
}

impl Active {
    fn encoded(&mut self, (latent, is_raw, taken, received): Encoded) -> Result<()> {
        match latent {
            Ok(latent) => {
                self.latents.publish(&latent)?;
                self.diagnostics.latency("encode").record(taken);
                let whole = self.diagnostics.latency("image to latent");
                whole.record(received.elapsed());
            }
            Err(error) => {
                // the next frames may be good by the other transport
                self.repeats.distrust(is_raw);
                self.complaints.left_out("bad_image", &error);
            }
        }
        Ok(())
    }

    fn frame(&mut self, frame: CameraFrame) {
        let (stamp, is_raw) = (frame.header().stamp, matches!(frame, CameraFrame::Raw(_)));
        match self.repeats.arrive(stamp, is_raw) {
            Arrival::New => {
                if let Some((late, _)) = self.work.submit((frame, Instant::now())) {
                    self.complaints.left_out("overload", &format_args!(
                        "the frame of {} waited when a newer one came: encoding is slower than the camera",
                        seconds(late.header().stamp),
                    ));
                }
            }
            Arrival::OtherTransport => {}
            Arrival::Duplicate => self.complaints.left_out(
                "duplicate",
                &format_args!("the frame of {} came twice", seconds(stamp)),
            ),
        }
    }
}
