use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use wm_bag::{BagMessage, BagReader, TopicInfo};
use wm_camera::{camera_frame::CameraFrame, transport::Transport};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    sensor_msgs::JointState,
    std_msgs::{Bool, Float32, String as Text},
    wm_msgs::Action,
};

use crate::{
    LeRobotError,
    info::{ACTION, IMAGES},
    topics::{
        ACTION_TOPIC, GRIPPER_NAME, GRIPPER_TOPIC, INSTRUCTION_TOPIC, JOINTS_TOPIC, POSE_NAMES,
        POSE_TOPIC, SUCCESS_TOPIC,
    },
};

/// The messages of a topic, in the order of their stamps.
#[derive(Debug)]
pub(super) struct Stream<T> {
    pub topic: String,
    /// In ns, increasing.
    pub stamps: Vec<u64>,
    /// One a stamp.
    pub values: Vec<T>,
}

/// What a bag holds of an episode, but for the pictures themselves.
#[derive(Debug)]
pub(super) struct Recording {
    pub bag: PathBuf,
    pub actions: Stream<Vec<f32>>,
    /// Joints, pose and gripper, those that are there.
    pub states: Vec<Stream<Vec<f32>>>,
    /// Names of an action's values.
    pub action_names: Vec<String>,
    /// Names of the values of all states, one after the other.
    pub state_names: Vec<String>,
    /// Each value is the message's number within its topic.
    pub cameras: Vec<Stream<u64>>,
    /// What to do about topics with pictures that are not read.
    unread: String,
    /// From when on each task holds.
    instructions: Vec<(u64, String)>,
    successes: Vec<(u64, bool)>,
}

/// An episode's part of a recording.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// In ns; the end is left out.
    pub time: Range<u64>,
    pub success: Option<bool>,
}

impl Recording {
    /// Reads all that is small; `cameras` are the topics to take, or none for all.
    pub fn read(bag: &Path, cameras: &[String]) -> Result<Self, LeRobotError> {
        let reader = BagReader::open(bag)?;
        let topics = camera_topics(&reader, cameras, bag)?;
        let unread = reader.topics().iter().filter_map(advice);
        let mut recording = Self {
            bag: bag.to_owned(),
            actions: Stream::new(ACTION_TOPIC),
            states: Vec::new(),
            action_names: Vec::new(),
            state_names: Vec::new(),
            cameras: topics.iter().map(|topic| Stream::new(topic)).collect(),
            unread: unread.map(|advice| format!("; {advice}")).collect(),
            instructions: Vec::new(),
            successes: Vec::new(),
        };
        let mut joints = Stream::new(JOINTS_TOPIC);
        let mut poses = Stream::new(POSE_TOPIC);
        let mut grippers = Stream::new(GRIPPER_TOPIC);
        let mut joint_names: Vec<String> = Vec::new();
        let mut numbers = vec![0u64; topics.len()];
        let mut wanted = vec![
            ACTION_TOPIC,
            JOINTS_TOPIC,
            POSE_TOPIC,
            GRIPPER_TOPIC,
            INSTRUCTION_TOPIC,
            SUCCESS_TOPIC,
        ];
        wanted.extend(topics.iter().map(String::as_str));
        for message in reader.messages().only_topics(wanted) {
            let message = message?;
            let logged = message.log_time_ns;
            let finite = |values: Vec<f32>| match values.iter().find(|value| !value.is_finite()) {
                None => Ok(values),
                Some(value) => Err(LeRobotError::unsuited(
                    bag,
                    format!("{}: a message at {logged} ns holds {value}", message.topic),
                )),
            };
            match &*message.topic {
                ACTION_TOPIC => {
                    let action: Action = message.decode()?;
                    let stamp = stamp(action.header.stamp, logged);
                    recording.actions.push(stamp, finite(action.values)?);
                }
                JOINTS_TOPIC => {
                    let state: JointState = message.decode()?;
                    if joint_names.is_empty() {
                        joint_names.clone_from(&state.name);
                    }
                    if state.name != joint_names || state.position.len() != state.name.len() {
                        return Err(LeRobotError::unsuited(
                            bag,
                            format!(
                                "{JOINTS_TOPIC}: expected one position for each of {joint_names:?}, got {} of {:?}",
                                state.position.len(),
                                state.name
                            ),
                        ));
                    }
                    let position = state.position.iter().map(|value| *value as f32).collect();
                    joints.push(stamp(state.header.stamp, logged), finite(position)?);
                }
                POSE_TOPIC => {
                    let pose: PoseStamped = message.decode()?;
                    let (p, q) = (pose.pose.position, pose.pose.orientation);
                    // LeRobot's states are single.
                    let values = [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(|value| value as f32);
                    poses.push(stamp(pose.header.stamp, logged), finite(values.to_vec())?);
                }
                GRIPPER_TOPIC => {
                    let gripper: Float32 = message.decode()?;
                    grippers.push(logged, finite(vec![gripper.data])?);
                }
                INSTRUCTION_TOPIC => {
                    let text: Text = message.decode()?;
                    recording.instructions.push((logged, text.data));
                }
                SUCCESS_TOPIC => {
                    let success: Bool = message.decode()?;
                    recording.successes.push((logged, success.data));
                }
                topic => {
                    let Some(at) = topics.iter().position(|known| known == topic) else {
                        continue;
                    };
                    if let (Some(stream), Some(number)) =
                        (recording.cameras.get_mut(at), numbers.get_mut(at))
                    {
                        stream.push(image_stamp(&message)?, *number);
                        *number += 1;
                    }
                }
            }
        }
        recording.action_names = action_names(&reader, &recording.actions.values)
            .map_err(|reason| LeRobotError::unsuited(bag, format!("{ACTION_TOPIC}: {reason}")))?;
        let named = [
            (joints, joint_names),
            (poses, POSE_NAMES.map(str::to_owned).to_vec()),
            (grippers, vec![GRIPPER_NAME.to_owned()]),
        ];
        for (stream, names) in named {
            if !stream.stamps.is_empty() {
                recording.states.push(stream);
                recording.state_names.extend(names);
            }
        }
        recording.check()?;
        Ok(recording)
    }

    fn check(&self) -> Result<(), LeRobotError> {
        let unsuited = |reason: String| Err(LeRobotError::unsuited(&self.bag, reason));
        let Some(first) = self.actions.values.first() else {
            return unsuited(format!("expected messages of {ACTION_TOPIC}, got none"));
        };
        if let Some(other) = self.actions.values.iter().find(|v| v.len() != first.len()) {
            return unsuited(format!(
                "{ACTION_TOPIC}: expected {} values as in the first, got {}",
                first.len(),
                other.len()
            ));
        }
        if first.is_empty() {
            return unsuited(format!(
                "{ACTION_TOPIC}: expected values, got none ({ACTION})"
            ));
        }
        if self.cameras.is_empty() {
            return unsuited(format!(
                "expected a camera, .../image_raw or .../image_raw/compressed{}",
                self.unread
            ));
        }
        match self.cameras.iter().find(|camera| camera.stamps.is_empty()) {
            Some(camera) => unsuited(format!("expected pictures on {}, got none", camera.topic)),
            None => Ok(()),
        }
    }

    /// The rate of the actions, to the nearest whole number.
    pub fn fps(&self) -> Result<u32, LeRobotError> {
        let stamps = &self.actions.stamps;
        let mut periods: Vec<u64> = stamps
            .windows(2)
            .map(|pair| match pair {
                [a, b] => b - a,
                _ => 0,
            })
            .collect();
        periods.sort_unstable();
        // The mean of the middle half: neither a gap nor a clock that trembles moves it.
        let quarter = periods.len() / 4;
        let middle = periods
            .get(quarter..periods.len() - quarter)
            .unwrap_or_default();
        let period_ns = middle.iter().sum::<u64>() as f64 / middle.len() as f64;
        let fps = (1e9 / period_ns).round();
        if (1.0..=1000.0).contains(&fps) {
            // Whole, and in range.
            Ok(fps as u32)
        } else {
            Err(LeRobotError::unsuited(
                &self.bag,
                format!(
                    "{ACTION_TOPIC}: expected 1 to 1000 actions per second, got one after {period_ns} ns; give the \
                     rate with --fps"
                ),
            ))
        }
    }

    /// The episodes: all of it, or the parts that several messages of `/task/success` end.
    pub fn parts(&self) -> Vec<Part> {
        let mut parts = Vec::new();
        let mut from = 0;
        for (number, (at, success)) in self.successes.iter().enumerate() {
            let is_last = number + 1 == self.successes.len();
            let to = if is_last { u64::MAX } else { at + 1 };
            parts.push(Part {
                time: from..to,
                success: Some(*success),
            });
            from = to;
        }
        if parts.is_empty() {
            parts.push(Part {
                time: 0..u64::MAX,
                success: None,
            });
        }
        parts
    }

    /// The task that holds at a time: the last one before, or the first of all.
    pub fn instruction(&self, at_ns: u64) -> Option<&str> {
        let before = self
            .instructions
            .iter()
            .rev()
            .find(|(from, _)| *from <= at_ns);
        before
            .or(self.instructions.first())
            .map(|(_, text)| text.as_str())
            .filter(|text| !text.is_empty())
    }

    /// Feature of a camera: `/front/image_raw/compressed` becomes `observation.images.front`.
    pub fn feature(topic: &str) -> String {
        let name = ["/image_raw/compressed", "/image_raw", "/compressed"]
            .iter()
            .find_map(|end| topic.strip_suffix(end))
            .unwrap_or(topic);
        let name = name.trim_matches('/').replace('/', "_");
        let name = if name.is_empty() { "camera" } else { &name };
        format!("{IMAGES}{name}")
    }
}

/// The names of an action's values: those of the bag's action space; numbers where it names none and has not Bridge V2's
/// seven.
fn action_names(reader: &BagReader, actions: &[Vec<f32>]) -> Result<Vec<String>, String> {
    let width = actions.first().map_or(0, Vec::len);
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

impl<T> Stream<T> {
    fn new(topic: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            stamps: Vec::new(),
            values: Vec::new(),
        }
    }

    /// Adds a message; one whose stamp is not later than the last is left out.
    fn push(&mut self, stamp: u64, value: T) {
        if self.stamps.last().is_none_or(|last| *last < stamp) {
            self.stamps.push(stamp);
            self.values.push(value);
        } else {
            tracing::warn!(
                topic = self.topic,
                stamp,
                "message ignored: it is not later than the previous message"
            );
        }
    }
}

/// The header's stamp, or when it was recorded where the header has none.
fn stamp(header: Time, logged: u64) -> u64 {
    match u64::try_from(header.to_nanos()) {
        Ok(0) | Err(_) => logged,
        Ok(stamp) => stamp,
    }
}

fn image_stamp(message: &BagMessage) -> Result<u64, LeRobotError> {
    let frame = CameraFrame::of_bag(message)?;
    Ok(stamp(frame.header().stamp, message.log_time_ns))
}

fn transport(topic: &TopicInfo) -> Option<Transport> {
    Transport::of(&topic.name, &topic.type_name)
}

fn is_read(topic: &TopicInfo) -> bool {
    transport(topic).is_some_and(Transport::is_read)
}

/// What to do about a topic with pictures that are not read.
fn advice(topic: &TopicInfo) -> Option<String> {
    transport(topic)?.advice(&topic.name)
}

/// The cameras that are asked for, or all; of a camera that is there raw and compressed, raw.
fn camera_topics(
    reader: &BagReader,
    asked: &[String],
    bag: &Path,
) -> Result<Vec<String>, LeRobotError> {
    for topic in asked {
        let info = reader.topic(topic);
        if !info.is_some_and(is_read) {
            let why = info.and_then(advice);
            let why = why.unwrap_or_else(|| "the bag has no image topic of this name".to_owned());
            let what = format!("expected pictures on {topic}, but {why}");
            return Err(LeRobotError::unsuited(bag, what));
        }
    }
    if !asked.is_empty() {
        return Ok(asked.to_vec());
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
