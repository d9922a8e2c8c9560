//! Listens to the graph.

use crate::{
    Actions, Arrival, Camera, DoctorError, Heard, Motion, Picture, Stream, comparison::Comparer,
};
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use wm_camera::{camera_frame::CameraFrame, transport::Transport};
use wm_msgs::{
    Message, cdr,
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus},
    geometry_msgs::{PoseStamped, TwistStamped},
    rosgraph_msgs::Clock,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
    tf2_msgs::TFMessage,
    wm_msgs::{Action, ActionChunk},
};
use wm_ros::logging::of_others;
use wm_ros::{
    Error, NAMESPACE, Node, NodeArgs, Qos, RawSubscription, Received, Reliability, RemoteEndpoint,
    Role,
};

/// The name in the graph.
const NAME: &str = "doctor";
/// Topics that are listened to; whoever makes more does not mean well.
const MOST_TOPICS: usize = 64;
/// Messages of a topic that are remembered: ten seconds at 10 kHz.
const MOST_MESSAGES: usize = 100_000;
/// Different frames, values and reports that are remembered of a topic.
const MOST_KEPT: usize = 32;
/// Actions that are remembered: a minute at 100 Hz.
const MOST_ACTIONS: usize = 6_000;
/// Pictures of a camera that the model is tried on.
const PICTURES: u32 = 6;
/// Messages that may wait to be read.
const DEPTH: usize = 64;
/// The suite's own pictures, which are no camera's.
const OWN_PICTURES: [&str; 4] = [
    "predicted/image",
    "plan/image",
    "goal/image",
    "candidates/image",
];

/// What is listened to, by its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Raw,
    Compressed,
    Action,
    Chunk,
    Clock,
    Diagnostics,
}

impl Kind {
    fn of(type_name: &str) -> Option<Self> {
        let kinds = [
            (Image::ros_name(), Self::Raw),
            (CompressedImage::ros_name(), Self::Compressed),
            (Action::ros_name(), Self::Action),
            (ActionChunk::ros_name(), Self::Chunk),
            (Clock::ros_name(), Self::Clock),
            (DiagnosticArray::ros_name(), Self::Diagnostics),
        ];
        kinds
            .into_iter()
            .find_map(|(name, kind)| (name == type_name).then_some(kind))
    }

    /// As the nodes ask for it: pictures best effort, the rest reliable where all publishers are.
    fn qos(self, publishers: &[Qos]) -> Qos {
        let all_reliable = publishers
            .iter()
            .all(|qos| qos.reliability == Reliability::Reliable);
        match self {
            Self::Raw | Self::Compressed => Qos::best_effort(DEPTH),
            _ if all_reliable => Qos::reliable(DEPTH),
            _ => Qos::best_effort(DEPTH),
        }
    }
}

/// The parameter `source` of the action adapter for a type.
fn adapter_source(type_name: &str) -> Option<&'static str> {
    let sources = [
        (TwistStamped::ros_name(), "twist"),
        (PoseStamped::ros_name(), "pose"),
        (TFMessage::ros_name(), "tf"),
    ];
    sources
        .into_iter()
        .find_map(|(name, source)| (name == type_name).then_some(source))
}

/// The parts of a message that the timeline needs.
#[derive(Default)]
struct Content {
    /// If its type has one.
    header: Option<Header>,
    /// Of a picture.
    fingerprint: Option<u64>,
}

impl Content {
    fn of(header: Header) -> Self {
        Self {
            header: Some(header),
            fingerprint: None,
        }
    }
}

/// What came on one topic.
struct Taken {
    kind: Kind,
    stream: Stream,
    frames: Vec<CameraFrame>,
    encoding: Option<String>,
    values: Vec<Vec<f32>>,
    rows: Vec<(i64, Vec<f32>)>,
    comparer: Option<Comparer>,
    clock_ns: Option<(i64, i64)>,
    reports: BTreeMap<String, (String, bool)>,
}

/// Joins the graph as `/wm/doctor` and listens for `span` to cameras, actions and what nodes report. `args` has
/// `--interface`.
///
/// # Errors
/// The graph cannot be joined, or an argument is wrong.
pub fn listen(args: &NodeArgs, span: Duration) -> Result<Heard, DoctorError> {
    let mut heard = Heard::default();
    wm_ros::run(
        NAME,
        NAMESPACE,
        args,
        async |node: Node| -> Result<(), Error> {
            node.seal_parameters()?;
            heard = hear(&node, span).await?;
            Ok(())
        },
    )?;
    Ok(heard)
}

async fn hear(node: &Node, span: Duration) -> Result<Heard, Error> {
    let began = Instant::now();
    let end = tokio::time::Instant::from_std(began + span);
    let mut changes = node.graph_changes();
    let shutdown = node.shutdown();
    let mut topics: BTreeSet<(String, String)> = BTreeSet::new();
    let mut tasks = JoinSet::new();
    loop {
        for (topic, publishers) in published(node) {
            let Some(kind) = Kind::of(&topic.1).filter(|_| topics.len() < MOST_TOPICS) else {
                continue;
            };
            let transport = Transport::of(&topic.0, &topic.1);
            if transport.is_some_and(|transport| !transport.is_read()) {
                continue;
            }
            if is_own(&topic.0) || !topics.insert(topic.clone()) {
                continue;
            }
            let (name, type_name) = topic;
            // A name that ROS does not allow is nobody's camera.
            let Ok(subscription) =
                node.raw_subscription_to_others(&name, &type_name, kind.qos(&publishers))
            else {
                continue;
            };
            tasks.spawn(take(kind, type_name, subscription, (began, span)));
        }
        tokio::select! {
            () = tokio::time::sleep_until(end) => break,
            () = shutdown.wait() => break,
            changed = changes.changed() => if changed.is_err() { break },
        }
    }
    let mut heard = Heard {
        span: began.elapsed(),
        ..Heard::default()
    };
    let published = published(node);
    // Those that have ended themselves: the shutdown ends all.
    while let Some(Ok(mut taken)) = tasks.join_next().await {
        let key = (taken.stream.topic.clone(), taken.stream.type_name.clone());
        taken.stream.publishers = published.get(&key).cloned().unwrap_or_default();
        enter(&mut heard, taken);
    }
    let endpoints = node.remote_endpoints();
    let participants: BTreeSet<_> = endpoints
        .iter()
        .map(|endpoint| endpoint.participant)
        .collect();
    heard.participants = participants.len();
    let motion = |(topic, type_name): &(String, String)| {
        let source = adapter_source(type_name)?;
        Some(Motion {
            topic: topic.clone(),
            type_name: type_name.clone(),
            source,
        })
    };
    let advice = |(topic, type_name): &(String, String)| {
        let transport = Transport::of(topic, type_name)?;
        transport.advice(&of_others(topic))
    };
    heard.unread = published
        .keys()
        .filter_map(advice)
        .take(MOST_TOPICS)
        .collect();
    heard.motions = published
        .keys()
        .filter_map(motion)
        .take(MOST_TOPICS)
        .collect();
    Ok(heard)
}

/// The topics that others publish, by name and type, and what their publishers offer.
fn published(node: &Node) -> BTreeMap<(String, String), Vec<Qos>> {
    let mut topics: BTreeMap<_, Vec<Qos>> = BTreeMap::new();
    let endpoints = node.remote_endpoints().into_iter();
    for RemoteEndpoint {
        name,
        type_name,
        qos,
        ..
    } in endpoints.filter(|endpoint| endpoint.role == Role::Publisher)
    {
        topics.entry((name, type_name)).or_default().push(qos);
    }
    topics
}

/// Whether the suite publishes it.
fn is_own(topic: &str) -> bool {
    let topic = topic.strip_suffix("/compressed").unwrap_or(topic);
    let own = topic
        .strip_prefix(NAMESPACE)
        .and_then(|rest| rest.strip_prefix('/'));
    own.is_some_and(|name| OWN_PICTURES.contains(&name))
}

/// Whether a message is of its type, but has an invalid time. The decoder passes the error on as text alone.
fn is_bad_time(error: &cdr::CdrError) -> bool {
    error.to_string().contains("expected less than 1e9 ns")
}

/// Takes what comes until `span` is over.
async fn take(
    kind: Kind,
    type_name: String,
    mut subscription: RawSubscription,
    (began, span): (Instant, Duration),
) -> Taken {
    let mut taken = Taken {
        kind,
        stream: Stream {
            topic: subscription.topic().to_owned(),
            type_name,
            ..Stream::default()
        },
        frames: Vec::new(),
        encoding: None,
        values: Vec::new(),
        rows: Vec::new(),
        comparer: None,
        clock_ns: None,
        reports: BTreeMap::new(),
    };
    let end = tokio::time::Instant::from_std(began + span);
    while let Ok(Some(received)) = tokio::time::timeout_at(end, subscription.recv()).await {
        taken.message(&received, (began, span));
    }
    taken.stream.lost = subscription.lost();
    taken
}

impl Taken {
    fn message(&mut self, received: &Received<bytes::Bytes>, (began, span): (Instant, Duration)) {
        let bytes = &received.message;
        self.stream.largest = self.stream.largest.max(bytes.len());
        let at = received.at.saturating_duration_since(began);
        let received_ns = received.received.to_nanos();
        let Content {
            header,
            fingerprint,
        } = match self.content(bytes, received_ns, (at, span)) {
            Ok(content) => content,
            Err(error) if is_bad_time(&error) => {
                self.stream.bad_times += 1;
                return;
            }
            Err(_) => {
                self.stream.undecodable += 1;
                return;
            }
        };
        if let Some(header) = &header
            && self.stream.frame_ids.len() < MOST_KEPT
        {
            self.stream.frame_ids.insert(header.frame_id.clone());
        }
        if self.stream.timeline.len() < MOST_MESSAGES {
            self.stream.timeline.0.push(Arrival {
                at,
                received_ns,
                stamp: header.map(|header| header.stamp),
                fingerprint,
            });
        }
    }

    /// Keeps the relevant parts of a message; gives those that the timeline needs.
    fn content(
        &mut self,
        bytes: &[u8],
        received_ns: i64,
        (at, span): (Duration, Duration),
    ) -> Result<Content, cdr::CdrError> {
        // Evenly spaced over the time of listening.
        let is_due = at >= span * self.frames.len() as u32 / PICTURES
            && self.frames.len() < PICTURES as usize;
        Ok(match self.kind {
            Kind::Raw => {
                let image: Image = cdr::from_bytes(bytes)?;
                self.encoding.get_or_insert_with(|| image.encoding.clone());
                self.frame(CameraFrame::Raw(image), received_ns, is_due)
            }
            Kind::Compressed => {
                let image: CompressedImage = cdr::from_bytes(bytes)?;
                self.encoding.get_or_insert_with(|| image.format.clone());
                self.frame(CameraFrame::Compressed(image), received_ns, is_due)
            }
            Kind::Action => {
                let action: Action = cdr::from_bytes(bytes)?;
                // The check of the stamps names malformed ones.
                if let Ok(stamp_ns) = action.header.stamp.checked_nanos()
                    && self.rows.len() < MOST_ACTIONS
                {
                    self.rows.push((stamp_ns, action.values.clone()));
                }
                self.keep(action.values);
                Content::of(action.header)
            }
            Kind::Chunk => Content::of(cdr::from_bytes::<ActionChunk>(bytes)?.header),
            Kind::Clock => {
                let clock: Clock = cdr::from_bytes(bytes)?;
                self.clock_ns = Some((clock.clock.to_nanos(), received_ns));
                Content::default()
            }
            Kind::Diagnostics => {
                let array: DiagnosticArray = cdr::from_bytes(bytes)?;
                array
                    .status
                    .into_iter()
                    .for_each(|status| self.report(status));
                Content::default()
            }
        })
    }

    /// Takes a picture: to compare it with the others and, if `is_due`, to try the model on.
    fn frame(&mut self, frame: CameraFrame, received_ns: i64, is_due: bool) -> Content {
        let content = Content {
            header: Some(frame.header().clone()),
            fingerprint: Some(frame.fingerprint()),
        };
        if is_due {
            self.frames.push(frame.clone());
        }
        let topic = &self.stream.topic;
        let comparer = self.comparer.get_or_insert_with(|| Comparer::new(topic));
        comparer.take(frame, received_ns);
        content
    }

    fn keep(&mut self, values: Vec<f32>) {
        if self.values.len() < MOST_KEPT {
            self.values.push(values);
        }
    }

    /// The newest word of each component counts.
    fn report(&mut self, status: DiagnosticStatus) {
        let is_bad = matches!(
            status.level,
            DiagnosticStatus::WARN | DiagnosticStatus::ERROR
        );
        if !is_bad {
            self.reports.remove(&status.name);
        } else if self.reports.len() < MOST_KEPT || self.reports.contains_key(&status.name) {
            let is_error = status.level == DiagnosticStatus::ERROR;
            self.reports.insert(status.name, (status.message, is_error));
        }
    }
}

/// Puts what came on a topic where it belongs.
fn enter(heard: &mut Heard, taken: Taken) {
    let Taken {
        kind,
        stream,
        frames,
        encoding,
        values,
        rows,
        comparer,
        clock_ns,
        reports,
    } = taken;
    let name = stream.topic.clone();
    match kind {
        Kind::Raw | Kind::Compressed => {
            let base = match kind {
                Kind::Compressed => name.strip_suffix("/compressed").unwrap_or(&name).to_owned(),
                _ => name,
            };
            let camera: &mut Camera = heard.cameras.entry(base).or_default();
            let decoded = frames.iter().map(|frame| {
                frame
                    .decode()
                    .map(Picture::of)
                    .map_err(|error| error.to_string())
            });
            // One transport's are enough; which, is no matter.
            if camera.pictures.is_empty() {
                camera.pictures = decoded.collect();
            }
            let comparison = comparer.map(Comparer::finish).unwrap_or_default();
            if comparison.pictures.count() > camera.comparison.pictures.count() {
                camera.comparison = comparison;
            }
            if camera.encoding.is_none() || kind == Kind::Raw {
                camera.encoding = encoding.or(camera.encoding.take());
            }
            match kind {
                Kind::Compressed => camera.compressed = Some(stream),
                _ => camera.raw = Some(stream),
            }
        }
        Kind::Action | Kind::Chunk => {
            let is_chunk = kind == Kind::Chunk;
            heard.actions.insert(
                name,
                Actions {
                    stream,
                    is_chunk,
                    values,
                    rows,
                },
            );
        }
        Kind::Clock => heard.clock_ns = clock_ns.or(heard.clock_ns),
        Kind::Diagnostics => heard.reports.extend(reports),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_suites_own_pictures_are_no_camera() {
        assert!(is_own("/wm/predicted/image") && is_own("/wm/goal/image/compressed"));
        assert!(!is_own("/camera/image_raw") && !is_own("/wm2/predicted/image"));
    }

    #[test]
    fn types_say_what_is_listened_to() {
        assert_eq!(Kind::of("sensor_msgs/msg/Image"), Some(Kind::Raw));
        assert_eq!(Kind::of("wm_msgs/msg/ActionChunk"), Some(Kind::Chunk));
        assert_eq!(Kind::of("std_msgs/msg/String"), None);
        assert_eq!(
            adapter_source("geometry_msgs/msg/TwistStamped"),
            Some("twist")
        );
    }

    #[test]
    fn invalid_times_are_told_apart_from_other_types() {
        let mut action = Action::default();
        action.header.stamp.nanosec = 1_000_000_000;
        let bytes = cdr::to_bytes(&action).unwrap();
        assert!(is_bad_time(&cdr::from_bytes::<Action>(&bytes).unwrap_err()));
        let bytes = cdr::to_bytes(&Action::default()).unwrap();
        let cut = bytes.get(..bytes.len() - 1).unwrap();
        assert!(!is_bad_time(&cdr::from_bytes::<Action>(cut).unwrap_err()));
    }

    #[test]
    fn actions_are_asked_for_as_their_publishers_offer() {
        assert_eq!(
            Kind::Action.qos(&[Qos::reliable(1)]).reliability,
            Reliability::Reliable
        );
        let mixed = [Qos::reliable(1), Qos::best_effort(1)];
        assert_eq!(
            Kind::Action.qos(&mixed).reliability,
            Reliability::BestEffort
        );
        assert_eq!(
            Kind::Raw.qos(&[Qos::reliable(1)]).reliability,
            Reliability::BestEffort
        );
    }
}
