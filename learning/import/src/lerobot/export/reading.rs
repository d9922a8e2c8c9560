//! Reads the content of a bag except the pictures.

use std::{collections::BTreeMap, fmt, path::Path, sync::Arc};

use wm_bag::{BagError, BagMessage, BagReader, TopicInfo};
use wm_camera::{camera_frame::CameraFrame, transport::Transport};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    sensor_msgs::JointState,
    std_msgs::{Bool, Float32, String as Text},
    wm_msgs::Action,
};

use super::recording::{Recording, Stream};
use crate::lerobot::{
    LeRobotError,
    topics::{
        ACTION_TOPIC, GRIPPER_NAME, GRIPPER_TOPIC, INSTRUCTION_TOPIC, JOINTS_TOPIC, POSE_NAMES,
        POSE_TOPIC, SUCCESS_TOPIC,
    },
};

/// The content of a bag: a recording per span of log times without a gap or a clock step.
#[derive(Debug)]
pub(super) struct BagContent {
    pub recordings: Vec<Recording>,
    /// Descriptions of skipped messages.
    pub dropped: Vec<String>,
}

/// The reason why a message is skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum DropReason {
    /// It cannot be decoded, for example because of an invalid stamp.
    Undecodable,
    /// Its stamp is not later than the previous one.
    NotLater,
    /// The recorder's clock passed the time twice.
    Doubled,
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Undecodable => "they cannot be decoded",
            Self::NotLater => "their stamps are not later than the previous one",
            Self::Doubled => "the recorder's clock stepped back, so their true order is unknown",
        })
    }
}

/// A fault of a message.
enum TakeError {
    /// The message is skipped.
    Dropped(DropReason, String),
    /// The bag cannot be exported.
    Refused(LeRobotError),
}

impl From<BagError> for TakeError {
    fn from(error: BagError) -> Self {
        Self::Dropped(DropReason::Undecodable, error.to_string())
    }
}

impl From<DropReason> for TakeError {
    fn from(reason: DropReason) -> Self {
        Self::Dropped(reason, String::new())
    }
}

impl From<LeRobotError> for TakeError {
    fn from(error: LeRobotError) -> Self {
        Self::Refused(error)
    }
}

/// The messages of one span.
struct Span {
    actions: Stream<Vec<f32>>,
    joints: Stream<Vec<f32>>,
    poses: Stream<Vec<f32>>,
    grippers: Stream<Vec<f32>>,
    cameras: Vec<Stream<u64>>,
    successes: Vec<(u64, bool)>,
}

impl Span {
    fn new(cameras: &[String]) -> Self {
        Self {
            actions: Stream::new(ACTION_TOPIC),
            joints: Stream::new(JOINTS_TOPIC),
            poses: Stream::new(POSE_TOPIC),
            grippers: Stream::new(GRIPPER_TOPIC),
            cameras: cameras.iter().map(|topic| Stream::new(topic)).collect(),
            successes: Vec::new(),
        }
    }
}

struct BagReading<'a> {
    bag: &'a Path,
    cameras: Vec<String>,
    spans: Vec<Span>,
    instructions: Vec<(u64, String)>,
    joint_names: Vec<String>,
    /// Number of messages of each camera so far.
    numbers: Vec<u64>,
    /// Their number, and details of the first.
    dropped: BTreeMap<(String, DropReason), (u64, String)>,
}

impl BagContent {
    /// Reads everything except pictures; `cameras` are the topics to read, empty for all.
    pub fn read(bag: &Path, cameras: &[String]) -> Result<Self, LeRobotError> {
        let reader = BagReader::open(bag)?;
        let cameras = select_cameras(&reader, cameras, bag)?;
        let starts = reader.unbroken_ns().iter().map(|(start_ns, _)| *start_ns);
        let starts: Vec<u64> = starts.collect();
        let mut reading = BagReading {
            bag,
            spans: (0..starts.len().max(1))
                .map(|_| Span::new(&cameras))
                .collect(),
            instructions: Vec::new(),
            joint_names: Vec::new(),
            numbers: vec![0; cameras.len()],
            cameras,
            dropped: BTreeMap::new(),
        };
        let mut wanted = vec![
            ACTION_TOPIC,
            JOINTS_TOPIC,
            POSE_TOPIC,
            GRIPPER_TOPIC,
            INSTRUCTION_TOPIC,
            SUCCESS_TOPIC,
        ];
        let cameras = reading.cameras.clone();
        wanted.extend(cameras.iter().map(String::as_str));
        for message in reader.messages().only_topics(wanted) {
            let message = message?;
            let at_ns = message.log_time_ns;
            let begun = starts.partition_point(|start_ns| *start_ns <= at_ns);
            let is_doubled = reader.is_doubled(at_ns);
            match reading.take(&message, begun.saturating_sub(1), is_doubled) {
                Ok(()) => {}
                Err(TakeError::Refused(error)) => return Err(error),
                Err(TakeError::Dropped(reason, details)) => {
                    let place = (message.topic.to_string(), reason);
                    reading.dropped.entry(place).or_insert((0, details)).0 += 1;
                }
            }
        }
        reading.finish(&reader)
    }
}

impl BagReading<'_> {
    fn take(
        &mut self,
        message: &BagMessage,
        span: usize,
        is_doubled: bool,
    ) -> Result<(), TakeError> {
        let topic = &*message.topic;
        let camera = self.cameras.iter().position(|known| known == topic);
        let number = camera.and_then(|at| self.numbers.get_mut(at));
        let number = number.map(|next| std::mem::replace(next, *next + 1));
        let logged = message.log_time_ns;
        if topic == INSTRUCTION_TOPIC {
            let text: Text = message.decode()?;
            self.instructions.push((logged, text.data));
            return Ok(());
        }
        let Some(span) = self.spans.get_mut(span) else {
            return Ok(());
        };
        if topic == SUCCESS_TOPIC {
            let success: Bool = message.decode()?;
            span.successes.push((logged, success.data));
            return Ok(());
        }
        let bag = self.bag;
        let finite = |values: Vec<f32>| match values.iter().find(|value| !value.is_finite()) {
            None => Ok(values),
            Some(value) => Err(LeRobotError::unsuited(
                bag,
                format!("{topic}: a message at {logged} ns holds {value}"),
            )),
        };
        let stamped = |header| effective_stamp(header, logged);
        match topic {
            ACTION_TOPIC => {
                let action: Action = message.decode()?;
                let at = stamped(action.header.stamp);
                span.actions.push(is_doubled, at, finite(action.values)?)?;
            }
            JOINTS_TOPIC => {
                let state: JointState = message.decode()?;
                if self.joint_names.is_empty() {
                    self.joint_names.clone_from(&state.name);
                }
                let names = &self.joint_names;
                if state.name != *names || state.position.len() != state.name.len() {
                    let reason = format!(
                        "{JOINTS_TOPIC}: expected one position for each of {names:?}, got {} of {:?}",
                        state.position.len(),
                        state.name
                    );
                    return Err(LeRobotError::unsuited(bag, reason).into());
                }
                let position = state.position.iter().map(|value| *value as f32).collect();
                let at = stamped(state.header.stamp);
                span.joints.push(is_doubled, at, finite(position)?)?;
            }
            POSE_TOPIC => {
                let pose: PoseStamped = message.decode()?;
                let (p, q) = (pose.pose.position, pose.pose.orientation);
                // LeRobot's states have single precision.
                let values = [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(|value| value as f32);
                let at = stamped(pose.header.stamp);
                span.poses.push(is_doubled, at, finite(values.to_vec())?)?;
            }
            GRIPPER_TOPIC => {
                let gripper: Float32 = message.decode()?;
                let values = finite(vec![gripper.data])?;
                span.grippers.push(is_doubled, logged, values)?;
            }
            _ => {
                let stream = camera.and_then(|at| span.cameras.get_mut(at));
                let (Some(stream), Some(number)) = (stream, number) else {
                    return Ok(());
                };
                stream.push(is_doubled, stamped(picture_stamp(message)?), number)?;
            }
        }
        Ok(())
    }

    fn finish(self, reader: &BagReader) -> Result<BagContent, LeRobotError> {
        let bag = self.bag;
        let mut all = self.spans.iter().flat_map(|span| &span.actions.values);
        let width = all.next().map_or(0, Vec::len);
        let action_names = action_names(reader, width)
            .map_err(|reason| LeRobotError::unsuited(bag, format!("{ACTION_TOPIC}: {reason}")))?;
        let has = |stream: fn(&Span) -> &Stream<Vec<f32>>| {
            (self.spans.iter()).any(|span| !stream(span).stamps.is_empty())
        };
        let is_there = [
            has(|span| &span.joints),
            has(|span| &span.poses),
            has(|span| &span.grippers),
        ];
        let names = [
            self.joint_names,
            POSE_NAMES.map(str::to_owned).to_vec(),
            vec![GRIPPER_NAME.to_owned()],
        ];
        let names = names.into_iter().zip(is_there);
        let state_names: Vec<String> = names
            .filter(|(_, is_there)| *is_there)
            .flat_map(|(names, _)| names)
            .collect();
        let instructions: Arc<[(u64, String)]> = self.instructions.into();
        let has_success = self.spans.iter().any(|span| !span.successes.is_empty());
        let has_no_camera = self.cameras.is_empty();
        let recordings = self.spans.into_iter().map(|span| {
            let states = [span.joints, span.poses, span.grippers].into_iter();
            Recording {
                bag: bag.to_owned(),
                actions: span.actions,
                states: states
                    .zip(is_there)
                    .filter(|(_, is_there)| *is_there)
                    .map(|(stream, _)| stream)
                    .collect(),
                action_names: action_names.clone(),
                state_names: state_names.clone(),
                cameras: span.cameras,
                instructions: Arc::clone(&instructions),
                successes: span.successes,
                has_success,
            }
        });
        let recordings: Vec<Recording> = recordings.collect();
        let dropped = self.dropped.iter();
        let dropped = dropped.map(|((topic, reason), (count, details))| {
            let bag = bag.display();
            let colon = if details.is_empty() { "" } else { ": " };
            format!("{bag}: {topic}: {count} message(s) are skipped: {reason}{colon}{details}")
        });
        let dropped: Vec<String> = dropped.collect();
        Recording::check(&recordings).map_err(|reason| {
            let unread = reader.topics().iter().filter_map(advice);
            let unread = unread.filter(|_| has_no_camera);
            let reasons = [reason]
                .into_iter()
                .chain(unread)
                .chain(dropped.iter().cloned());
            LeRobotError::unsuited(bag, reasons.collect::<Vec<_>>().join("; "))
        })?;
        Ok(BagContent {
            recordings,
            dropped,
        })
    }
}

impl<T> Stream<T> {
    fn new(topic: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            stamps: Vec::new(),
            values: Vec::new(),
        }
    }

    /// Adds a message, if it is later than the last one.
    fn push(&mut self, is_doubled: bool, stamp: u64, value: T) -> Result<(), DropReason> {
        if is_doubled {
            return Err(DropReason::Doubled);
        }
        if self.stamps.last().is_some_and(|last| *last >= stamp) {
            return Err(DropReason::NotLater);
        }
        self.stamps.push(stamp);
        self.values.push(value);
        Ok(())
    }
}

/// The header's stamp, or the log time if the stamp is 0.
fn effective_stamp(header: Time, logged: u64) -> u64 {
    match u64::try_from(header.to_nanos()) {
        Ok(0) | Err(_) => logged,
        Ok(stamp) => stamp,
    }
}

fn picture_stamp(message: &BagMessage) -> Result<Time, BagError> {
    Ok(CameraFrame::of_bag(message)?.header().stamp)
}

fn transport(topic: &TopicInfo) -> Option<Transport> {
    Transport::of(&topic.name, &topic.type_name)
}

fn is_read(topic: &TopicInfo) -> bool {
    transport(topic).is_some_and(Transport::is_read)
}

/// Advice for a topic with unreadable pictures.
fn advice(topic: &TopicInfo) -> Option<String> {
    transport(topic)?.advice(&topic.name)
}

/// The names of an action's values: from the bag's action space, or Bridge V2's for seven values, otherwise numbers.
fn action_names(reader: &BagReader, width: usize) -> Result<Vec<String>, String> {
    let note = reader.note(ActionSpace::NOTE);
    let space = ActionSpace::of_note(note).map_err(|error| error.to_string())?;
    if width == space.len() {
        let dimensions = space.dimensions().iter();
        return Ok(dimensions.map(|dimension| dimension.name.clone()).collect());
    }
    if note.is_some() && width > 0 {
        return Err(format!(
            "actions of {width} values, expected those of {space}"
        ));
    }
    Ok((0..width)
        .map(|number| format!("action_{number}"))
        .collect())
}

/// The requested cameras, or all; raw topics win over compressed ones.
fn select_cameras(
    reader: &BagReader,
    requested: &[String],
    bag: &Path,
) -> Result<Vec<String>, LeRobotError> {
    for topic in requested {
        let info = reader.topic(topic);
        if !info.is_some_and(is_read) {
            let why = info.and_then(advice);
            let why = why.unwrap_or_else(|| "the bag has no image topic of this name".to_owned());
            let what = format!("expected pictures on {topic}, but {why}");
            return Err(LeRobotError::unsuited(bag, what));
        }
    }
    if !requested.is_empty() {
        return Ok(requested.to_vec());
    }
    let is_camera = |name: &str| {
        !name.starts_with("/wm/")
            && (name.ends_with("/image_raw") || name.ends_with("/image_raw/compressed"))
    };
    let found = reader.topics().iter().filter(|topic| {
        let raw = topic.name.strip_suffix("/compressed");
        let has_raw = raw
            .and_then(|raw| reader.topic(raw))
            .is_some_and(|raw| raw.message_count > 0);
        topic.message_count > 0 && is_read(topic) && is_camera(&topic.name) && !has_raw
    });
    Ok(found.map(|topic| topic.name.to_string()).collect())
}
