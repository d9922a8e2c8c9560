//! The encoder's ROS interface.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use tokio::sync::watch;
use wm_model::{Framing, LatentSpace, PictureSize};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::{Duration as Span, Time},
    wm_msgs::{Action, CameraState, Latent},
};
use wm_ros::{
    Clock, Diagnostics, Input, Level, NodeDefinition, Publisher, Qos, Subscription,
    complaints::Complaints, frame_trace,
};
use wm_zoo::ModelFolder;

use super::{
    Choice, EncoderError, EncoderStep, Fate, Mismatch, Needs, Repetition, Sight, Stillness,
    choice::log_selection,
    decoding::{DecodedFrame, Decoding, ReceivedFrame},
    job::{Job, RecentPictures},
    other_transports,
    parameters::Parameters,
    picture_size::{PictureSizes, SizeChange},
    repeats::{Arrival, Repeats},
};
use crate::{
    cadence::{PACE, SKIPPED, measured},
    camera::{Admission, Camera, Source, WrongCamera},
    harness::{self, ModelNode, ModelSetup},
    history::{Reception, Timing, epoch_after, seconds, stamp_of_frame, stamp_of_other},
    pool::Pool,
    work::Work,
};
use wm_camera::camera_frame::CameraFrame;
use wm_wire::{latent_message::LATENT_QOS, transport::ImageSubscription};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Encoder>();

/// A camera that is silent for longer may be replaced by another. A restart of its driver takes about as long.
const SILENCE: Duration = Duration::from_secs(1);
/// Without a frame for this long after the start, the node looks for the camera on other transports.
const MISSING: Duration = Duration::from_secs(5);
/// Advice for a missing camera.
const NO_CAMERA: &str = "start the camera's driver, or name its topic: camera:=TOPIC for wm launch, -r /camera/image_raw:=TOPIC for the node";

wm_ros::endpoints! {
    /// Topics.
    struct Endpoints {
        /// The camera's frames.
        images: ImageSubscription = "/camera/image_raw", qos(Qos::sensor_data());
        /// Actions that the robot takes: if the arm moves, the picture of a live camera changes.
        actions: Subscription<Action> = "action";
        /// The latents of the frames, stamped with the frames' capture time.
        latents: Publisher<Latent> = "latent", qos(LATENT_QOS);
        /// Whether the camera has stopped, and at which rate it takes pictures. One message for each frame.
        states: Publisher<CameraState> = "camera_state", qos(Qos::reliable(10));
    }
}

/// The latent or the error of a frame, whether the frame was raw, how long encoding took, and when the frame was received.
type Encoded = (Result<Latent, EncoderError>, bool, Duration, Instant);

/// The loaded parts of the model.
struct Model {
    step: Arc<Mutex<EncoderStep>>,
    space: LatentSpace,
    framing: Framing,
    /// Encodes frames. The trial has already used the memory that they need.
    pool: Pool,
    /// The time of a frame in the trial; `None` if the trial failed.
    estimate: Option<Duration>,
    needs: Needs,
    actions: ActionSpace,
    sizes: PictureSizes,
}

impl Model {
    /// Whether its latents, its choice of frames and its actions are those of `other`.
    fn encodes_like(&self, other: &Self) -> bool {
        self.space == other.space && self.needs == other.needs && self.actions == other.actions
    }
}

struct Encoder {
    decoding: Decoding,
    work: Work<Job, Encoded>,
    recent: RecentPictures,
    /// Pictures that are still to be encoded again.
    again: usize,
    /// Selects the frames to encode.
    choice: Choice,
    needs: Needs,
    clock: Clock,
    jumps: watch::Receiver<u64>,
    /// The epoch of the frames.
    epoch: u64,
    /// The epoch that began with the last jump of the clock or change of the camera. Earlier frames keep their epoch.
    begun: u64,
    sizes: PictureSizes,
    /// The camera that the node follows; `None` before the first frame.
    camera: Option<Camera>,
    repeats: Repeats,
    repetition: Repetition,
    stillness: Stillness,
    /// Whether the camera has stopped.
    is_frozen: bool,
    /// Whether the log has warned of repeated frames.
    is_repeating: bool,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl ModelNode for Encoder {
    const NAME: &'static str = "encoder";
    const ABOUT: &'static str = "Encodes camera frames to latents.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;
    const MAKES_LATENTS: bool = true;

    fn space(model: &Model) -> Option<&LatentSpace> {
        Some(&model.space)
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let step = EncoderStep::of_model(&folder, parameters.dtype)?;
        tracing::info!("encoding to latent space {}", step.space());
        let encoding = folder.action_encoding()?;
        // Without a transition model, nothing is predicted and the timing has no effect.
        let timing = encoding.clone().unwrap_or_default();
        let timing = Timing::of_camera(parameters.frame_period, &timing);
        let needs = Needs {
            frame_period: timing.frame_period(),
            frame_skip: timing.frame_skip,
            context_frames: parameters.context_frames,
        };
        let pool = Pool::foreground(Self::NAME)?;
        let estimate = pool
            .run(|| measured(|| step.try_out()))
            .inspect_err(|error| tracing::warn!("trial encoding failed: {error}"))
            .ok();
        if let Some(taken) = estimate {
            log_selection(&Choice::new(needs, estimate), taken, &needs);
        }
        let sizes = PictureSizes::new(step.framing(), folder.trained_on()?);
        Ok(Model {
            sizes,
            space: step.space().clone(),
            framing: step.framing(),
            step: Arc::new(Mutex::new(step)),
            pool,
            estimate,
            needs,
            actions: encoding.map_or_else(ActionSpace::bridge, |encoding| encoding.space().clone()),
        })
    }

    fn activate(at: &ModelSetup<Self>) -> Result<Self> {
        let Model {
            step,
            pool,
            estimate,
            needs,
            actions,
            sizes,
            framing,
            ..
        } = &at.resources;
        let step = Arc::clone(step);
        let framing = at.parameters.follows_model().then_some(*framing);
        let recent = RecentPictures::new(needs, framing);
        let kept = recent.clone();
        let choice = Choice::new(*needs, *estimate);
        let work = Work::new(choice.room(), move |job: Job, _| {
            let step = step.lock().unwrap_or_else(PoisonError::into_inner);
            let started = Instant::now();
            frame_trace::passed("encoding begun", job.header.stamp);
            let (is_raw, received) = (job.is_raw, job.received);
            let latent = kept.encode(job, &step);
            (latent, is_raw, started.elapsed(), received)
        })
        .on(pool);
        let diagnostics = at.node.diagnostics();
        diagnostics.set_value(PACE, choice.mode().in_words(needs));
        let images = at.endpoints.images.topics();
        diagnostics.expect_input(Input::new("camera images", images, NO_CAMERA));
        let clock = at.node.clock();
        let epoch = epoch_after(0, clock.now());
        Ok(Self {
            decoding: Decoding::new(),
            work,
            recent,
            again: 0,
            choice,
            needs: *needs,
            jumps: clock.jumps(),
            epoch,
            begun: epoch,
            sizes: sizes.clone(),
            clock,
            camera: None,
            repeats: Repeats::default(),
            repetition: Repetition::default(),
            stillness: Stillness::new(at.parameters.frozen_after, actions.clone()),
            is_frozen: false,
            is_repeating: false,
            complaints: Complaints::new(diagnostics.clone()),
            diagnostics,
        })
    }

    fn adopt(&mut self, at: &mut ModelSetup<Self>, model: Model) -> Result<()> {
        if model.encodes_like(&at.resources) {
            return Ok(());
        }
        let has_same_actions = model.actions == at.resources.actions;
        at.resources = model;
        let new = Self::activate(at)?;
        let before = std::mem::replace(self, new);
        self.continue_from(before, has_same_actions, at.resources.framing);
        Ok(())
    }

    async fn run(&mut self, at: &mut ModelSetup<Self>) -> Result<()> {
        let Endpoints {
            images,
            actions,
            latents,
            states,
        } = &mut *at.endpoints;
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
                decoded = self.decoding.work.finished() => {
                    self.decoded(decoded.context("the decoder's thread")?, states)?;
                }
                Ok(()) = self.jumps.changed() => self.restart(),
                received = actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    self.action(received.message);
                }
                received = images.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let reception = Reception::of(&received, &self.clock);
                    self.frame(received.message, &reception);
                }
            }
        }
    }
}

impl Encoder {
    /// Follows the camera of the encoder `before` in a new epoch, and encodes its last pictures again.
    fn continue_from(&mut self, mut before: Self, has_same_actions: bool, framing: Framing) {
        self.epoch = epoch_after(before.epoch, self.clock.now());
        // Frames that are being decoded are of the new epoch.
        self.begun = before.begun;
        let mut jobs = before.recent.take(before.epoch, framing, Instant::now());
        let waiting = before.work.take_waiting().into_iter();
        jobs.extend(waiting.filter(|job| job.epoch == before.epoch));
        self.again = jobs.len();
        self.make_room();
        for job in jobs {
            // There is room for all.
            let _ = self.work.submit(Job {
                epoch: self.epoch,
                ..job
            });
        }
        self.decoding = before.decoding;
        self.camera = before.camera;
        self.repeats = before.repeats;
        self.repetition = before.repetition;
        if has_same_actions {
            self.stillness = before.stillness;
            self.is_frozen = before.is_frozen;
            self.is_repeating = before.is_repeating;
        }
    }

    /// Lets as many pictures wait as the selection of frames needs, and those that are encoded again.
    fn make_room(&mut self) {
        self.work.set_capacity(self.choice.room() + self.again);
    }

    fn encoded(
        &mut self,
        (latent, is_raw, taken, received): Encoded,
        latents: &Publisher<Latent>,
    ) -> Result<()> {
        if self.again > 0 {
            self.again -= 1;
            self.make_room();
        }
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
            Err(error) => self.unusable(is_raw, &error),
        }
        Ok(())
    }

    /// Counts an unusable frame. The other transport of the camera may still be good.
    fn unusable(&mut self, is_raw: bool, error: &EncoderError) {
        self.repeats.distrust(is_raw);
        self.complaints.left_out("bad_image", error);
    }

    /// Takes an action: if the arm moves, the picture of a live camera changes.
    fn action(&mut self, Action { header, values }: Action) {
        let stamp_ns = match stamp_of_other("action", header.stamp) {
            Ok(stamp_ns) => stamp_ns,
            Err(error) => return self.complaints.left_out(error.reason(), &error),
        };
        if let Err(error) = self.stillness.action(stamp_ns, values) {
            let text = format_args!(
                "{error}: without the arm's motions, a camera is frozen only if its picture repeats exactly"
            );
            self.complaints.left_out("malformed_action", &text);
        }
    }

    /// Compares the size of a picture with the previous one and with the training's.
    fn size(&mut self, size: PictureSize) {
        let change = self.sizes.take(size);
        let mismatch = self.sizes.mismatch();
        if let Some(mismatch) = mismatch.filter(Mismatch::is_serious) {
            let text = format!("{mismatch}; {}", mismatch.fix());
            self.diagnostics.raise("camera pictures", Level::Warn, text);
        }
        let Some(change) = change else {
            return;
        };
        self.diagnostics
            .set_value("camera picture", self.sizes.in_words());
        match change {
            SizeChange::First => {}
            SizeChange::Size { from } => {
                tracing::info!("the camera's pictures changed from {from} to {size} pixels");
            }
            // Earlier frames show another part of the scene, so they are no context of later ones.
            SizeChange::Aspect { from } => {
                self.epoch = epoch_after(self.epoch, self.clock.now());
                tracing::warn!(
                    "the camera's pictures changed from {from} to {size} pixels, another aspect: a new epoch begins"
                );
            }
        }
        match mismatch {
            Some(mismatch) if mismatch.is_serious() => {
                tracing::warn!("{mismatch}; {}", mismatch.fix());
            }
            Some(mismatch) => tracing::info!("{mismatch}"),
            None => {}
        }
    }

    fn frame(&mut self, frame: CameraFrame, reception: &Reception) {
        if let Err(error) = self.follow(&frame, reception) {
            self.complaints.left_out(WrongCamera::REASON, &error);
            return;
        }
        let (stamp, is_raw) = (frame.header().stamp, matches!(frame, CameraFrame::Raw(_)));
        if let Err(error) = stamp_of_frame(stamp, reception) {
            self.complaints.left_out(error.reason(), &error);
            return;
        }
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

    /// Selects whether a frame is encoded. It is decoded in any case, for the state of the camera.
    fn choose(&mut self, frame: CameraFrame, reception: &Reception) {
        let stamp = frame.header().stamp;
        let stamp_ns = stamp.to_nanos();
        let repeat = self.repetition.frame(stamp_ns, frame.fingerprint());
        // A model step counts the pictures of the camera, not their copies.
        let fate = match repeat.is_surplus() {
            true => Fate::Skip,
            false => {
                let waiting = self.work.waiting();
                self.choice.arrived(stamp_ns, reception.at, waiting)
            }
        };
        match fate {
            Fate::Encode => {}
            Fate::Skip => self.diagnostics.count_skipped(SKIPPED, 1),
            Fate::Late => self.late(stamp),
        }
        let lost = self
            .decoding
            .submit(frame, reception.at, self.epoch, (fate, repeat));
        if let Some(ReceivedFrame { frame, fate, .. }) = lost
            && fate == Fate::Encode
        {
            self.late(frame.header().stamp);
        }
    }

    fn late(&mut self, stamp: Time) {
        self.complaints.left_out(
            "overload",
            &format_args!(
                "the frame of {} is dropped, because encoding is slower than before or than the camera",
                seconds(stamp),
            ),
        );
    }

    /// Publishes the state of the camera by a decoded frame, and encodes the frame if it was selected.
    fn decoded(&mut self, decoded: DecodedFrame, states: &Publisher<CameraState>) -> Result<()> {
        let DecodedFrame {
            mut header,
            is_raw,
            at,
            epoch,
            fate,
            repeat,
            picture,
        } = decoded;
        let (picture, grid) = match picture {
            None => (None, None),
            Some(Ok((picture, grid))) => (Some(picture), Some(grid)),
            Some(Err(error)) => {
                self.unusable(is_raw, &error.into());
                return Ok(());
            }
        };
        if let Some(picture) = &picture {
            self.size(PictureSize::of(picture));
        }
        if let Some(camera) = &self.camera
            && header.frame_id.is_empty()
        {
            header.frame_id = camera.frame_id().to_string();
        }
        let sight = self
            .stillness
            .frame(header.stamp.to_nanos(), &repeat, grid.as_ref());
        self.report(&sight);
        let is_frozen = sight.frozen.is_some();
        if self.is_frozen && !is_frozen {
            // Frames from the stop show an earlier time, so no context may contain them.
            tracing::info!("the camera's picture changes again");
            self.epoch = epoch_after(self.epoch, self.clock.now());
        }
        self.is_frozen = is_frozen;
        let change = sight.change.unwrap_or(CameraState::NOT_MEASURED);
        states.publish(&CameraState {
            header: header.clone(),
            change,
            unchanged: Span::from_nanos(sight.unchanged_ns),
            // 0: not measured yet. A rate of a camera fits into 32 bits.
            rate: sight.rate.unwrap_or_default() as f32,
            distinct_rate: sight.distinct_rate.unwrap_or_default() as f32,
            frozen: is_frozen,
            reason: sight
                .frozen
                .map_or_else(String::new, |frozen| frozen.to_string()),
        })?;
        let Some(picture) = picture.filter(|_| fate == Fate::Encode) else {
            return Ok(());
        };
        let late = self.work.submit(Job {
            picture,
            header,
            is_raw,
            received: at,
            epoch: if epoch < self.begun {
                epoch
            } else {
                self.epoch
            },
            change,
            is_frozen,
        });
        if let Some(late) = late {
            self.late(late.header.stamp);
        }
        Ok(())
    }

    /// Reports faults of the camera on `/diagnostics` and in the log.
    fn report(&mut self, sight: &Sight) {
        if let Some(frozen) = &sight.frozen {
            if !self.is_frozen {
                tracing::error!("{frozen}");
            }
            self.diagnostics
                .raise("camera", Level::Error, frozen.to_string());
        }
        let rates = sight.rate.zip(sight.distinct_rate);
        let Some((rate, distinct)) = rates else {
            return;
        };
        self.diagnostics
            .set_value("camera rate [Hz]", format!("{rate:.1}"));
        self.diagnostics
            .set_value("camera rate of new pictures [Hz]", format!("{distinct:.1}"));
        if sight.is_repeating {
            let text = format!(
                "the camera publishes {rate:.0} frames a second, but only {distinct:.0} of them differ from the one before: \
                 its rate is {distinct:.1} Hz; set the driver's rate, or a shorter exposure"
            );
            if !self.is_repeating {
                tracing::warn!("{text}");
            }
            self.diagnostics.raise("camera rate", Level::Warn, text);
        }
        self.is_repeating = sight.is_repeating;
    }

    /// Notes the time of a frame, and reports a change of the selection of frames.
    fn took(&mut self, taken: Duration) {
        self.choice.took(taken);
        let Some(taken) = self.choice.change() else {
            return;
        };
        self.make_room();
        log_selection(&self.choice, taken, &self.needs);
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
            self.repeats = Repeats::default();
            self.restart();
        }
        Ok(())
    }

    /// Starts a new epoch: the next frame is from another time or another camera.
    fn restart(&mut self) {
        self.epoch = epoch_after(self.epoch, self.clock.now());
        self.begun = self.epoch;
        self.choice.restart();
        self.repetition.restart();
        self.stillness.restart();
    }
}
