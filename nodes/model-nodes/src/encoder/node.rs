//! The encoder on the wire.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use tokio::sync::watch;
use wm_msgs::wm_msgs::Latent;
use wm_ros::{
    Clock, Diagnostics, Input, Node, NodeDefinition, Publisher, Qos, complaints::Complaints,
    frame_trace,
};
use wm_zoo::ModelFolder;

use super::{
    EncoderError, EncoderStep,
    repeats::{Arrival, Repeats},
};
use crate::{
    camera::{Admission, Camera, Source, WrongCamera},
    harness::{self, Configured, ModelNode},
    history::{Reception, epoch_after, seconds},
    pool::Pool,
    work::Work,
};
use wm_camera::camera_frame::CameraFrame;
use wm_wire::{
    latent_message::{LATENT_QOS, LatentDtype},
    transport::{ImageSubscription, Transports},
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Encoder>();

/// Length of the queue of frames behind the one that is being encoded.
const WAITING: usize = 1;
/// A camera that is silent for longer may be replaced by another: as long as it takes to start a driver again.
const SILENCE: Duration = Duration::from_secs(1);
/// Advice for a missing camera.
const NO_CAMERA: &str = "start the camera's driver, or remap /camera/image_raw to its topic";

/// The node itself, in a process that may run other nodes too.
///
/// # Errors
/// Parameters are invalid, weights cannot be loaded, or the graph fails.
pub async fn body(node: Node) -> Result<()> {
    harness::body::<Encoder>(node).await
}

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Number type of the latents. In f16 a latent of the embedded model takes 6 KB.
        dtype: LatentDtype = "f16", one_of {
            "f32" => LatentDtype::F32, "f16" => LatentDtype::F16, "bf16" => LatentDtype::Bf16,
        };
        /// Image transport of the camera. With both, a frame that arrives twice counts once.
        image_transport: Transports = "both";
    }
}

wm_ros::endpoints! {
    /// Topics.
    struct Endpoints {
        /// The camera's frames.
        images: ImageSubscription = "/camera/image_raw", qos(Qos::sensor_data());
        /// The latents of the frames, stamped with the frames' capture time.
        latents: Publisher<Latent> = "latent", qos(LATENT_QOS);
    }
}

/// An encoded frame or why there is none, whether it came raw, how long it took, and when it came.
type Encoded = (Result<Latent, EncoderError>, bool, Duration, Instant);

struct Encoder {
    work: Work<(CameraFrame, Instant, u64), Encoded>,
    clock: Clock,
    jumps: watch::Receiver<u64>,
    /// The epoch of the frames.
    epoch: u64,
    /// The camera that it follows, once a frame has arrived.
    camera: Option<Camera>,
    repeats: Repeats,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl ModelNode for Encoder {
    const NAME: &'static str = "encoder";
    const ABOUT: &'static str = "Encodes camera frames to latents.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Arc<Mutex<EncoderStep>>;

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Self::Model> {
        let step = EncoderStep::new(folder.encoder()?, parameters.dtype);
        tracing::info!("encoding to latent space {}", step.space());
        Ok(Arc::new(Mutex::new(step)))
    }

    fn activate(at: &Configured<Self>) -> Result<Self> {
        let step = Arc::clone(&at.model);
        let work = Work::new(
            WAITING,
            move |(frame, received, epoch): (CameraFrame, Instant, u64), _| {
                let step = step.lock().unwrap_or_else(PoisonError::into_inner);
                let started = Instant::now();
                frame_trace::passed("encoding begun", frame.header().stamp);
                let is_raw = matches!(frame, CameraFrame::Raw(_));
                let latent = step.encode(&frame).map(|latent| Latent { epoch, ..latent });
                (latent, is_raw, started.elapsed(), received)
            },
        )
        .on(&Pool::new(Self::NAME, 0)?);
        let diagnostics = at.node.diagnostics();
        let images = at.endpoints.images.topics();
        diagnostics.expect_input(Input::new("camera images", images, NO_CAMERA));
        let clock = at.node.clock();
        Ok(Self {
            work,
            jumps: clock.jumps(),
            epoch: epoch_after(0, clock.now()),
            clock,
            camera: None,
            repeats: Repeats::default(),
            complaints: Complaints::new(diagnostics.clone()),
            diagnostics,
        })
    }

    async fn run(&mut self, at: &mut Configured<Self>) -> Result<()> {
        let Endpoints { images, latents } = &mut at.endpoints;
        loop {
            tokio::select! {
                biased;
                finished = self.work.finished() => self.encoded(finished.context("the encoder's thread")?, latents)?,
                Ok(()) = self.jumps.changed() => self.epoch = epoch_after(self.epoch, self.clock.now()),
                received = images.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let reception = Reception::from(&received);
                    self.frame(received.message, &reception);
                }
            }
        }
    }
}

impl Encoder {
    fn encoded(
        &mut self,
        (latent, is_raw, taken, received): Encoded,
        latents: &Publisher<Latent>,
    ) -> Result<()> {
        match latent {
            Ok(latent) => {
                let stamp = latent.header.stamp;
                frame_trace::passed("latent taken", stamp);
                latents.publish_shared(Arc::new(latent))?;
                frame_trace::passed("latent published", stamp);
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

    fn frame(&mut self, frame: CameraFrame, reception: &Reception) {
        if let Err(error) = self.follow(&frame, reception) {
            self.complaints.left_out(WrongCamera::REASON, &error);
            return;
        }
        let (stamp, is_raw) = (frame.header().stamp, matches!(frame, CameraFrame::Raw(_)));
        match self.repeats.arrive(stamp, is_raw) {
            Arrival::New => {
                frame_trace::passed_at("image received", stamp, reception.at);
                frame_trace::passed("image taken", stamp);
                let job = (frame, Instant::now(), self.epoch);
                if let Some((late, ..)) = self.work.submit(job) {
                    self.complaints.left_out("overload", &format_args!(
                        "dropped the waiting frame of {}, because a newer one arrived: encoding is slower than the \
                         camera",
                        seconds(late.header().stamp),
                    ));
                }
            }
            Arrival::OtherTransport => {}
            Arrival::Duplicate => self.complaints.left_out(
                "duplicate",
                &format_args!("the frame of {} arrived twice", seconds(stamp)),
            ),
        }
    }

    /// Follows the first camera that publishes. If another one takes over, a new epoch starts.
    fn follow(&mut self, frame: &CameraFrame, reception: &Reception) -> Result<(), WrongCamera> {
        let frame_id = frame.header().frame_id.as_str();
        let source = match frame {
            CameraFrame::Raw(_) => Source::Raw,
            CameraFrame::Compressed(_) => Source::Compressed,
        };
        let Some(camera) = &mut self.camera else {
            self.camera = Some(Camera::new(frame_id, source, reception));
            return Ok(());
        };
        if camera.admit(frame_id, source, reception, SILENCE)? == Admission::TakenOver {
            tracing::info!("following another camera now: \"{frame_id}\"");
            self.epoch = epoch_after(self.epoch, self.clock.now());
            self.repeats = Repeats::default();
        }
        Ok(())
    }
}
