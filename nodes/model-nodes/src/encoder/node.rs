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
use wm_zoo::PlacedModel;

use super::{
    Choice, EncoderError, EncoderStep, Fate, Mode, Needs, other_transports,
    repeats::{Arrival, Repeats},
};
use crate::{
    cadence::{OPEN, PACE, SKIPPED, hertz, measured, rough},
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

/// A camera that is silent for longer may be replaced by another: as long as it takes to start a driver again.
const SILENCE: Duration = Duration::from_secs(1);
/// A camera that is silent for longer after the start is looked for by other transports.
const MISSING: Duration = Duration::from_secs(5);
/// What raises the rate.
const FASTER: &str = "for more: a smaller encoder, or a faster processor";
/// Advice for a missing camera.
const NO_CAMERA: &str = "start the camera's driver, or name its topic: camera:=TOPIC for wm launch, -r /camera/image_raw:=TOPIC for the node";

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
        /// Time from one camera frame to the next [s], as in the model's training. With context_frames, it says which
        /// frames are encoded where encoding is slower than the camera.
        frame_period: f64 = 0.2, in 1e-3..=60.0;
        /// Number of observed frames that predictions start from, one model step apart, as on the predictor.
        context_frames: usize = 2, in 1..=64;
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

/// What the node loads.
struct Model {
    step: Arc<Mutex<EncoderStep>>,
    /// How long a frame took when it was tried out.
    estimate: Option<Duration>,
    needs: Needs,
}

struct Encoder {
    work: Work<(CameraFrame, Instant, u64), Encoded>,
    /// Which frames are encoded.
    choice: Choice,
    needs: Needs,
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
    type Model = Model;

    fn load(folder: PlacedModel, parameters: &Parameters) -> Result<Self::Model> {
        let step = EncoderStep::new(folder.encoder()?, parameters.dtype);
        tracing::info!("encoding to latent space {}", step.space());
        let needs = Needs {
            // The range keeps it positive and within a minute.
            frame_period: Duration::from_secs_f64(parameters.frame_period),
            // Without a transition model nothing is predicted.
            frame_skip: folder.frame_skip()?.unwrap_or(1),
            context_frames: parameters.context_frames,
        };
        let estimate = measured(|| step.try_out())
            .inspect_err(|error| tracing::warn!("encoding was tried out, and failed: {error}"))
            .ok();
        if let Some(taken) = estimate {
            say(&Choice::new(needs, estimate), taken, &needs);
        }
        Ok(Model {
            step: Arc::new(Mutex::new(step)),
            estimate,
            needs,
        })
    }

    fn activate(at: &Configured<Self>) -> Result<Self> {
        let Model {
            step,
            estimate,
            needs,
        } = &at.model;
        let step = Arc::clone(step);
        let choice = Choice::new(*needs, *estimate);
        let work = Work::new(
            choice.room(),
            move |(frame, received, epoch): (CameraFrame, Instant, u64), _| {
                let step = step.lock().unwrap_or_else(PoisonError::into_inner);
                let started = Instant::now();
                frame_trace::passed("encoding begun", frame.header().stamp);
                let is_raw = matches!(frame, CameraFrame::Raw(_));
                let latent = step.encode(&frame).map(|latent| Latent { epoch, ..latent });
                (latent, is_raw, started.elapsed(), received)
            },
        )
        .on(&Pool::foreground(Self::NAME)?);
        let diagnostics = at.node.diagnostics();
        diagnostics.set_value(PACE, choice.mode().in_words(needs));
        let images = at.endpoints.images.topics();
        diagnostics.expect_input(Input::new("camera images", images, NO_CAMERA));
        let clock = at.node.clock();
        Ok(Self {
            work,
            choice,
            needs: *needs,
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
        let mut missing = std::pin::pin!(tokio::time::sleep(MISSING));
        let mut is_looked_for = false;
        loop {
            tokio::select! {
                biased;
                finished = self.work.finished() => self.encoded(finished.context("the encoder's thread")?, latents)?,
                () = &mut missing, if !is_looked_for => {
                    is_looked_for = true;
                    if self.camera.is_none() {
                        other_transports::warn(&at.node);
                    }
                }
                Ok(()) = self.jumps.changed() => {
                    self.epoch = epoch_after(self.epoch, self.clock.now());
                    self.choice.restart();
                }
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
                self.took(taken);
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
                self.choose(frame, reception);
            }
            Arrival::OtherTransport => {}
            Arrival::Duplicate => self.complaints.left_out(
                "duplicate",
                &format_args!("the frame of {} arrived twice", seconds(stamp)),
            ),
        }
    }

    /// Encodes a frame, or leaves it out, by choice or since encoding is behind.
    fn choose(&mut self, frame: CameraFrame, reception: &Reception) {
        let stamp = frame.header().stamp;
        let waiting = self.work.waiting();
        let late = match self.choice.arrived(stamp.to_nanos(), reception.at, waiting) {
            Fate::Skip => return self.diagnostics.count_skipped(SKIPPED, 1),
            Fate::Late => Some(stamp),
            Fate::Encode => {
                let job = (frame, Instant::now(), self.epoch);
                let late = self.work.submit(job);
                late.map(|(late, ..)| late.header().stamp)
            }
        };
        if let Some(late) = late {
            self.complaints.left_out("overload", &format_args!(
                "the frame of {} is dropped, because encoding is slower than before or than the camera",
                seconds(late),
            ));
        }
    }

    /// Takes note of how long a frame took, and says if that changes which frames are encoded.
    fn took(&mut self, taken: Duration) {
        self.choice.took(taken);
        let Some(taken) = self.choice.change() else {
            return;
        };
        self.work.set_capacity(self.choice.room());
        say(&self.choice, taken, &self.needs);
        let words = self.choice.mode().in_words(&self.needs);
        self.diagnostics.set_value(PACE, words);
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
            self.choice.restart();
        }
        Ok(())
    }
}

/// Says which frames are encoded here.
fn say(choice: &Choice, taken: Duration, needs: &Needs) {
    let mode = choice.mode();
    let (taken, rate, words) = (
        rough(taken),
        hertz(needs.frame_period),
        mode.in_words(needs),
    );
    let text = format!("encoding a frame takes about {taken} here; at {rate}");
    match mode {
        _ if choice.is_open() => tracing::info!("{text}, {OPEN}"),
        Mode::All => tracing::info!("{text}, {words}"),
        Mode::Every(_) | Mode::Contexts(_) => tracing::warn!("{text}, {words}; {FASTER}"),
    }
}
