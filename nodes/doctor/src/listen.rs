//! Subscribes to the topics of the graph for some seconds.

use crate::{
    Actions, Arrival, Camera, DoctorError, Motion, Picture, Stream, Survey, comparison::Comparer,
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

const NAME: &str = "doctor";
/// The most topics; more are hardly meant well.
const MOST_TOPICS: usize = 64;
/// The most messages per topic: ten seconds at 10 kHz.
const MOST_MESSAGES: usize = 100_000;
/// The most distinct frames, values and reports per topic.
const MOST_KEPT: usize = 32;
/// The most actions: a minute at 100 Hz.
const MOST_ACTIONS: usize = 6_000;
/// Pictures per camera that the model is run on.
const PICTURES: u32 = 6;
/// Messages that wait to be read.
const DEPTH: usize = 64;
/// The suite's own pictures, which do not come from a camera.
const OWN_PICTURES: [&str; 5] = [
    "predicted/image",
    "plan/image",
    "plan/subgoals/image",
    "goal/image",
    "candidates/image",
];

/// Topics by type.
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

    /// The QoS that the nodes request: best effort for pictures, otherwise reliable if all publishers are.
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
    /// `None` if the type has none.
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

/// The messages of one topic.
struct TopicRecord {
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

/// Joins the graph as `/wm/doctor` and listens for `span` to cameras, actions and reports of nodes. `args` may contain
/// `--interface`.
///
/// # Errors
/// The graph cannot be joined, or an argument is wrong.
pub fn listen(args: &NodeArgs, span: Duration) -> Result<Survey, DoctorError> {
    let mut survey = Survey::default();
    wm_ros::run(
        NAME,
        NAMESPACE,
        args,
        async |node: Node| -> Result<(), Error> {
            node.seal_parameters()?;
            survey = collect(&node, span).await?;
            Ok(())
        },
    )?;
    Ok(survey)
}

async fn collect(node: &Node, span: Duration) -> Result<Survey, Error> {
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
            // a name that ROS does not allow is not a camera's
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
    let mut survey = Survey {
        span: began.elapsed(),
        ..Survey::default()
    };
    let published = published(node);
    // also those that ended early: the shutdown ends the rest
    while let Some(Ok(mut record)) = tasks.join_next().await {
        let key = (record.stream.topic.clone(), record.stream.type_name.clone());
        record.stream.publishers = published.get(&key).cloned().unwrap_or_default();
        enter(&mut survey, record);
    }
    let endpoints = node.remote_endpoints();
    let participants: BTreeSet<_> = endpoints
        .iter()
        .map(|endpoint| endpoint.participant)
        .collect();
    survey.participants = participants.len();
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
    survey.unread = published
        .keys()
        .filter_map(advice)
        .take(MOST_TOPICS)
        .collect();
    survey.motions = published
        .keys()
        .filter_map(motion)
        .take(MOST_TOPICS)
        .collect();
    Ok(survey)
}

/// The topics that others publish, by name and type, with the QoS of their publishers.
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

fn is_own(topic: &str) -> bool {
    let topic = topic.strip_suffix("/compressed").unwrap_or(topic);
    let own = topic
        .strip_prefix(NAMESPACE)
        .and_then(|rest| rest.strip_prefix('/'));
    own.is_some_and(|name| OWN_PICTURES.contains(&name))
}

/// Receives until `span` is over.
async fn take(
    kind: Kind,
    type_name: String,
    mut subscription: RawSubscription,
    (began, span): (Instant, Duration),
) -> TopicRecord {
    let mut record = TopicRecord {
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
        record.message(&received, (began, span));
    }
    record.stream.lost = subscription.lost();
    record
}

impl TopicRecord {
    fn message(&mut self, received: &Received<bytes::Bytes>, (began, span): (Instant, Duration)) {
        let bytes = &received.message;
        self.stream.largest = self.stream.largest.max(bytes.len());
        let at = received.at.saturating_duration_since(began);
        let received_ns = received.received.to_nanos();
        let content = self.content(bytes, received_ns, (at, span));
        let Content {
            header,
            fingerprint,
        } = match content {
            Ok(content) => content,
            Err(error) => {
                self.stream.undecodable += 1;
                let first = &mut self.stream.first_undecodable;
                first.get_or_insert_with(|| error.to_string());
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

    /// Stores the relevant parts of a message, and returns the parts for the timeline.
    fn content(
        &mut self,
        bytes: &[u8],
        received_ns: i64,
        (at, span): (Duration, Duration),
    ) -> Result<Content, cdr::CdrError> {
        // evenly spaced over the time of listening
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
                // the check of stamps reports malformed ones
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

    /// Takes a picture for comparison and, if `is_due`, for running the model.
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

    /// The newest report of each component counts.
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

/// Adds the messages of one topic.
fn enter(survey: &mut Survey, record: TopicRecord) {
    let TopicRecord {
        kind,
        stream,
        frames,
        encoding,
        values,
        rows,
        comparer,
        clock_ns,
        reports,
    } = record;
    let name = stream.topic.clone();
    match kind {
        Kind::Raw | Kind::Compressed => {
            let base = match kind {
                Kind::Compressed => name.strip_suffix("/compressed").unwrap_or(&name).to_owned(),
                _ => name,
            };
            let camera: &mut Camera = survey.cameras.entry(base).or_default();
            let decoded = frames.iter().map(|frame| {
                frame
                    .decode()
                    .map(Picture::of)
                    .map_err(|error| error.to_string())
            });
            // the pictures of either transport suffice
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
            survey.actions.insert(
                name,
                Actions {
                    stream,
                    is_chunk,
                    values,
                    rows,
                },
            );
        }
        Kind::Clock => survey.clock_ns = clock_ns.or(survey.clock_ns),
        Kind::Diagnostics => survey.reports.extend(reports),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_pictures_are_not_cameras() {
        assert!(is_own("/wm/predicted/image") && is_own("/wm/goal/image/compressed"));
        assert!(!is_own("/camera/image_raw") && !is_own("/wm2/predicted/image"));
    }

    #[test]
    fn type_decides_the_kind_of_topic() {
        assert_eq!(Kind::of("sensor_msgs/msg/Image"), Some(Kind::Raw));
        assert_eq!(Kind::of("wm_msgs/msg/ActionChunk"), Some(Kind::Chunk));
        assert_eq!(Kind::of("std_msgs/msg/String"), None);
        assert_eq!(
            adapter_source("geometry_msgs/msg/TwistStamped"),
            Some("twist")
        );
    }

    #[test]
    fn subscription_qos_follows_the_publishers() {
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
