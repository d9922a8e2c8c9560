//! The node's ROS interface.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use image::RgbImage;
use wm_camera::{camera_frame::CameraFrame, image_message::encode_image};
use wm_msgs::{builtin_interfaces::Time, sensor_msgs::Image, std_msgs::Header, wm_msgs::Action};
use wm_ros::{
    Clock, Diagnostics, Input, Level, Node, NodeDefinition, NodeProgram, Publisher, Qos, Setup,
    Subscription, complaints::Complaints, frame_trace,
};

use super::{
    Arrival, DropReason, JoinError, Joiner, Match, Matcher,
    camera_view::{Admitted, CameraView},
    cameras::Cameras,
    joiner::decode,
    parameters::Parameters,
    rule::Rule,
    tally::Tally,
};
use crate::{
    encoder::{Grid, Repeat, Stillness},
    history::{Reception, seconds, stamp_of_other},
    work::Work,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Views>();

/// Moments that may wait to be joined: joining takes milliseconds.
const JOBS: usize = 2;
/// The watched inputs, by the index of their camera.
const INPUTS: [&str; 4] = [
    "images of camera 1",
    "images of camera 2",
    "images of camera 3",
    "images of camera 4",
];
/// Advice for a missing camera.
const NO_CAMERA: &str = "start the camera's driver, or correct its topic in the parameter cameras; without it, nothing is predicted";
/// The status while pictures are published.
const WORKING: &str = "joining the pictures of all cameras";

wm_ros::endpoints! {
    /// Topics.
    pub(super) struct Endpoints {
        /// The frames of a camera. The parameter cameras sets the topics.
        cameras: Cameras = "/front/image_raw", qos(Qos::sensor_data());
        /// Actions that the robot takes: if the arm moves, the picture of a live camera changes.
        actions: Subscription<Action> = "action";
        /// The pictures of all cameras side by side, as the model takes them, with stamp and frame of the first camera.
        pictures: Publisher<Image> = "views/image_raw";
    }
}

/// A frame that waits for those of the other cameras.
struct WaitingFrame {
    frame: CameraFrame,
    stamp_ns: i64,
    repeat: Repeat,
    at: Instant,
}

/// Frames of one moment.
struct Job {
    header: Header,
    frames: Vec<WaitingFrame>,
}

/// The picture of a moment.
struct JoinedMoment {
    header: Header,
    frames: Vec<WaitingFrame>,
    /// With the cells of each camera's picture.
    joined: Result<(RgbImage, Vec<Grid>), JoinError>,
}

struct Views {
    views: Vec<CameraView>,
    /// One for each camera.
    tallies: Vec<Tally>,
    matcher: Matcher<WaitingFrame>,
    tolerance: Duration,
    work: Work<Job, JoinedMoment>,
    clock: Clock,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl NodeProgram for Views {
    const NAME: &'static str = "views";
    const ABOUT: &'static str =
        "Joins the frames of several cameras to the pictures of a model of several views.";
    const IS_MANAGED: bool = true;
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Resources = Rule;
    type Error = anyhow::Error;

    fn check(parameters: &Parameters) -> Result<()> {
        parameters.check()
    }

    async fn load(_: &Node, parameters: &Arc<Parameters>) -> Result<Rule> {
        let (parameters, span) = (Arc::clone(parameters), tracing::Span::current());
        let open = move || span.in_scope(|| Rule::of_model(&parameters));
        tokio::task::spawn_blocking(open).await?
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        let node = &at.node;
        let Rule {
            framing,
            rules,
            actions,
        } = at.resources.clone();
        let diagnostics = node.diagnostics();
        let output = at.endpoints.pictures.topic();
        let (mut views, mut tallies) = (Vec::new(), Vec::new());
        let topics = at.endpoints.cameras.topics();
        for ((name, topics), given) in INPUTS.iter().zip(topics).zip(&at.parameters.cameras) {
            let topic = node.resolve(given)?;
            ensure!(
                topic != output,
                "parameter cameras has {topic}, which is the topic of the joined pictures: remap that, for example -r \
                 views/image_raw:=joined/image_raw"
            );
            diagnostics.expect_input(Input::new(name, topics, NO_CAMERA));
            let stillness = Stillness::new(at.parameters.frozen_after, actions.clone());
            views.push(CameraView::new(&topic, stillness));
            tallies.push(Tally::new(&topic, diagnostics.clone()));
        }
        let tolerance = Duration::from_nanos(rules.tolerance_ns.unsigned_abs());
        let (height, width) = framing.size;
        tracing::info!(
            "joining {} in {width}x{height}, fit {}, with stamps at most {:.3} s apart",
            at.parameters.cameras.join(", "),
            framing.fit,
            tolerance.as_secs_f64()
        );
        let joiner = Joiner::new(framing);
        let mut complaints = Complaints::new(diagnostics.clone());
        complaints.waiting("start", true, &"frames of all cameras");
        Ok(Self {
            matcher: Matcher::new(rules, views.len()),
            views,
            tallies,
            tolerance,
            work: Work::new(JOBS, move |job: Job, _| join(&joiner, job)),
            clock: node.clock(),
            complaints,
            diagnostics,
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let Endpoints {
            cameras,
            actions,
            pictures,
        } = &mut at.endpoints;
        let mut jumps = self.clock.jumps();
        loop {
            tokio::select! {
                biased;
                joined = self.work.finished() => self.joined(joined.context("the joining thread")?, pictures)?,
                Ok(()) = jumps.changed() => self.restart(),
                received = actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    self.action(received.message);
                }
                received = cameras.recv() => {
                    let Some((camera, received)) = received else { return Ok(()) };
                    let reception = Reception::of(&received, &self.clock);
                    self.frame(camera, received.message, &reception);
                }
            }
        }
    }
}

fn join(joiner: &Joiner, Job { header, frames }: Job) -> JoinedMoment {
    let joined = decode(frames.iter().map(|waiting| &waiting.frame)).and_then(|pictures| {
        let grids = pictures.iter().map(Grid::of).collect();
        Ok((joiner.place(&pictures)?, grids))
    });
    frame_trace::passed("views joined", header.stamp);
    JoinedMoment {
        header,
        frames,
        joined,
    }
}

impl Views {
    /// Takes an action of the arm.
    fn action(&mut self, Action { header, values }: Action) {
        let stamp_ns = match stamp_of_other("action", header.stamp) {
            Ok(stamp_ns) => stamp_ns,
            Err(error) => return self.complaints.left_out(error.reason(), &error),
        };
        for view in &mut self.views {
            if let Err(error) = view.action(stamp_ns, values.clone()) {
                // It is the same for all cameras.
                let text = format!(
                    "{error}: without the arm's motions, a camera is frozen only if its picture repeats exactly"
                );
                return self.complaints.left_out("malformed_action", &text);
            }
        }
    }

    fn frame(&mut self, camera: usize, frame: CameraFrame, reception: &Reception) {
        let (Some(view), Some(tally)) = (self.views.get_mut(camera), self.tallies.get_mut(camera))
        else {
            return;
        };
        match view.admit(&frame, reception) {
            Ok(Admitted::Copy) => {}
            Ok(Admitted::Frame {
                stamp_ns,
                lag,
                repeat,
                is_taken_over,
            }) => {
                if let Some(lag) = lag {
                    tally.lag(lag);
                }
                if is_taken_over {
                    let drops = self.matcher.restart(camera);
                    self.take(Arrival {
                        matches: Vec::new(),
                        drops,
                    });
                }
                let waiting = WaitingFrame {
                    frame,
                    stamp_ns,
                    repeat,
                    at: reception.at,
                };
                let arrival = self.matcher.arrive(camera, stamp_ns, waiting);
                self.take(arrival);
            }
            Err(refusal) => {
                tally.dropped();
                let text = format!("{}: {refusal}", view.topic());
                self.complaints.left_out(refusal.reason(), &text);
            }
        }
    }

    fn take(&mut self, arrival: Arrival<WaitingFrame>) {
        for drop in arrival.drops {
            self.drop(drop.camera, drop.stamp_ns, drop.reason);
        }
        for found in arrival.matches {
            self.submit(found);
        }
    }

    /// Counts a frame that is in no picture.
    fn drop(&mut self, camera: usize, stamp_ns: i64, reason: DropReason) {
        let topics: Vec<&str> = self.views.iter().map(CameraView::topic).collect();
        // Indices of the matcher are those of its cameras.
        let topic = |camera: usize| topics.get(camera).copied().unwrap_or("?").to_owned();
        let frame = format!(
            "{}: the frame of {}",
            topic(camera),
            seconds(Time::from_nanos(stamp_ns))
        );
        match reason {
            DropReason::Surplus => {
                self.diagnostics
                    .count_skipped("frame of a camera faster than the others", 1);
                if let Some(tally) = self.tallies.get_mut(camera) {
                    tally.skipped();
                }
                return;
            }
            DropReason::OutOfOrder => {
                let text = format!("{frame} is not later than the one before");
                self.complaints.left_out("out_of_order", &text);
            }
            DropReason::TimeJump => {
                let text = format!("{frame} waited for the other cameras when time jumped");
                self.complaints.left_out("time_jump", &text);
            }
            DropReason::Unmatched {
                missing,
                nearest_ns,
            } => {
                let missing = topic(missing);
                let nearest = match nearest_ns {
                    None => "no frame of it has arrived".to_owned(),
                    Some(ns) => format!("its nearest frame is {}", distance(ns)),
                };
                let tolerance = self.tolerance.as_secs_f64();
                let text = format!(
                    "{frame} has no partner of {missing} within {tolerance:.3} s of it: {nearest}"
                );
                self.complaints.left_out("unmatched", &text);
                let text = format!("frames of {missing}");
                self.complaints.waiting(&missing, false, &text);
            }
        }
        if let Some(tally) = self.tallies.get_mut(camera) {
            tally.dropped();
        }
    }

    /// Starts to join the frames of a moment.
    fn submit(&mut self, found: Match<WaitingFrame>) {
        for (tally, offset_ns) in self.tallies.iter_mut().zip(&found.offsets_ns) {
            tally.used(*offset_ns);
        }
        let Some(reference) = found.frames.first() else {
            return;
        };
        let mut header = reference.frame.header().clone();
        frame_trace::passed("views matched", header.stamp);
        if header.frame_id.is_empty()
            && let Some(view) = self.views.first()
        {
            header.frame_id = view.frame_id();
        }
        let frames = found.frames;
        if let Some(late) = self.work.submit(Job { header, frames }) {
            let stamp = seconds(late.header.stamp);
            let text = format!(
                "the frames of {stamp} are dropped, because joining is slower than the cameras"
            );
            self.complaints.left_out("overload", &text);
        }
    }

    /// Publishes the picture of a moment, unless a camera has stopped.
    fn joined(&mut self, moment: JoinedMoment, pictures: &Publisher<Image>) -> Result<()> {
        let JoinedMoment {
            header,
            frames,
            joined,
        } = moment;
        let (picture, grids) = match joined {
            Ok(joined) => joined,
            Err(JoinError { view, source }) => {
                let frame = frames.get(view).map(|waiting| &waiting.frame);
                if let Some(view) = self.views.get_mut(view) {
                    view.distrust(matches!(frame, Some(CameraFrame::Raw(_))));
                    let text = format!("{}: {source}", view.topic());
                    self.complaints.left_out("bad_image", &text);
                }
                return Ok(());
            }
        };
        let mut has_frozen = false;
        for ((view, waiting), grid) in self.views.iter_mut().zip(&frames).zip(&grids) {
            let Some(reason) = view.seen(waiting.stamp_ns, &waiting.repeat, grid) else {
                continue;
            };
            has_frozen = true;
            let text = format!("{}: {reason}", view.topic());
            let subject = format!("camera {}", view.topic());
            self.complaints.left_out("frozen", &text);
            self.diagnostics.raise(&subject, Level::Error, text);
            let text = format!("a new picture of {}", view.topic());
            self.complaints.waiting(&text, false, &text);
        }
        if has_frozen {
            return Ok(());
        }
        pictures.publish(&encode_image(&picture, header))?;
        if let Some(reference) = frames.first() {
            let whole = self.diagnostics.latency("image to joined picture");
            whole.record(reference.at.elapsed());
        }
        self.complaints.working(WORKING);
        Ok(())
    }

    /// Starts anew: the clock has jumped.
    fn restart(&mut self) {
        let mut drops = Vec::new();
        for camera in 0..self.matcher.cameras() {
            drops.extend(self.matcher.restart(camera));
        }
        self.views.iter_mut().for_each(CameraView::restart);
        self.take(Arrival {
            matches: Vec::new(),
            drops,
        });
    }
}

/// A time relative to a frame's, for people.
fn distance(ns: i64) -> String {
    let seconds = ns as f64 / 1e9;
    match ns < 0 {
        true => format!("{:.3} s earlier", -seconds),
        false => format!("{seconds:.3} s later"),
    }
}
