use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use wm_audit::{ActionTrack, Finding, JOINTS_TOPIC, POSE_TOPICS, RecordedTopics, Stamps, StateLog};
use wm_bag::{BagError, BagMessage, BagReader, TopicInfo};
use wm_camera::transport::base;
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    Message as _,
    geometry_msgs::PoseStamped,
    sensor_msgs::JointState,
    std_msgs::{Bool, String as Text},
    vision_msgs::LabelInfo,
};

use super::{
    Settings,
    action_log::ActionLog,
    camera_message::CameraMessage,
    cameras::{CAMERA, MASK, cameras},
    manifest::Thing,
    options::StampSource,
    spans::Spans,
    unusable_bag::UnusableBag,
};

const INSTRUCTION: &str = "/task/instruction";
const SUCCESS: &str = "/task/success";
const LABELS: &str = "/camera/mask/label_info";
/// More size changes than this, and than every tenth picture, mean two cameras.
const MOST_RESIZES: usize = 16;

/// The times of a topic's pictures.
#[derive(Debug)]
pub(super) struct Stream {
    pub topic: String,
    /// By ascending stamp.
    pub pictures: Vec<Picture>,
    /// Pictures with a stamp not above the previous one.
    unordered: u64,
    /// Width and height of the last picture \[px\].
    size: Option<(u32, u32)>,
    /// Number of size changes.
    resizes: usize,
    /// Pictures of a video earlier than its first keyframe.
    before_keyframe: u64,
}

/// When a picture was taken and recorded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Picture {
    pub stamp_ns: i64,
    pub logged_ns: u64,
}

/// A bag without its pictures. Positions of other messages are the number of earlier pictures of the first camera: the
/// recording order is known even if clocks differ.
#[derive(Debug)]
pub(super) struct Recording {
    /// Cameras, and masks if any.
    pub streams: Vec<Stream>,
    pub has_masks: bool,
    pub actions: ActionLog,
    pub action_topic: String,
    pub instructions: Vec<(usize, String)>,
    pub successes: Vec<(usize, bool)>,
    /// Meaning of the mask values.
    pub labels: Vec<(usize, BTreeMap<u8, String>)>,
    /// Positions of messages of a `--cut-topic`.
    pub cuts: Vec<usize>,
    /// Positions at which the clock is set back or the pictures change in size, within a recording.
    pub breaks: Vec<usize>,
    /// Whether the bag has such a topic.
    pub has_cut_topic: bool,
    /// Invalid messages: count, kind and the first fault.
    pub complaints: Vec<(u64, Thing, String)>,
    /// Stamps and pictures, for the audit.
    pub recorded: RecordedTopics,
    /// State of the arm, for the audit.
    pub state: StateLog,
}

/// Undecodable pictures.
#[derive(Clone, Debug, Default)]
pub(super) struct BrokenPictures {
    /// Topic and stamp \[ns\].
    pictures: BTreeSet<(String, i64)>,
    /// Fault of the first picture, by topic.
    reasons: BTreeMap<String, String>,
}

impl BrokenPictures {
    pub fn insert(&mut self, topic: &str, stamp_ns: i64, reason: impl FnOnce() -> String) {
        self.pictures.insert((topic.to_owned(), stamp_ns));
        if !self.reasons.contains_key(topic) {
            self.reasons.insert(topic.to_owned(), reason());
        }
    }

    pub fn contains(&self, topic: &str, stamp_ns: i64) -> bool {
        self.pictures.contains(&(topic.to_owned(), stamp_ns))
    }

    pub fn is_empty(&self) -> bool {
        self.pictures.is_empty()
    }

    /// Adds other pictures; known reasons stay.
    pub fn extend(&mut self, other: Self) {
        self.pictures.extend(other.pictures);
        for (topic, reason) in other.reasons {
            self.reasons.entry(topic).or_insert(reason);
        }
    }

    /// The reasons with their topics.
    fn reasons(&self) -> String {
        let reasons = self.reasons.iter();
        let reasons = reasons.map(|(topic, reason)| format!("{topic}: {reason}"));
        reasons.collect::<Vec<_>>().join("; ")
    }
}

impl Recording {
    /// Reads a bag once without keeping its pictures; skips those in `broken`.
    pub fn read(
        reader: &BagReader,
        settings: &Settings,
        space: &ActionSpace,
        broken: &BrokenPictures,
    ) -> Result<Self, UnusableBag> {
        let topics = cameras(reader, &settings.cameras).map_err(UnusableBag::Lacks)?;
        let action_topic = settings.action_topic.as_str();
        check_actions(reader, action_topic).map_err(UnusableBag::Lacks)?;
        let mut streams: Vec<Stream> = topics.iter().map(|topic| Stream::new(topic)).collect();
        let has_messages = |name: &str| reader.topic(name).is_some_and(|t| t.message_count > 0);
        let is_masked = |topics: &[String]| matches!(topics, [only] if base(only) == CAMERA);
        let has_masks = is_masked(&topics) && has_messages(MASK);
        if has_masks {
            streams.push(Stream::new(MASK));
        }
        let views = topics.iter().map(String::as_str);
        let recorded = RecordedTopics::new(views, action_topic);
        let state_topics = state_topics(reader, action_topic);
        let mut recording = Self {
            recorded,
            state: StateLog::default(),
            streams,
            has_masks,
            actions: ActionLog::new(space),
            action_topic: action_topic.to_owned(),
            instructions: Vec::new(),
            successes: Vec::new(),
            labels: Vec::new(),
            cuts: Vec::new(),
            breaks: Vec::new(),
            has_cut_topic: settings.cut_topics.iter().any(|name| has_messages(name)),
            complaints: Vec::new(),
        };
        // Count and first fault, by topic.
        let mut unreadable: BTreeMap<Option<Arc<str>>, (u64, String)> = BTreeMap::new();
        let mut skipped = 0;
        let mut spans = Spans::of(reader);
        let wanted = recording.streams.iter().map(|s| s.topic.as_str());
        let wanted = wanted.chain(settings.cut_topics.iter().map(String::as_str));
        let wanted = wanted.chain([action_topic, INSTRUCTION, SUCCESS]);
        let wanted = wanted.chain(has_masks.then_some(LABELS));
        let wanted = wanted.chain(state_topics.iter().copied());
        let messages = reader.messages().only_topics(wanted);
        for message in messages {
            let topic = message.as_ref().ok().map(|m| Arc::clone(&m.topic));
            let read = message
                .map_err(|error| UnusableBag::Lacks(error.to_string()))
                .and_then(|message| {
                    if spans.begins(message.log_time_ns) {
                        recording.cut();
                    }
                    let is_latched = [INSTRUCTION, SUCCESS, LABELS].contains(&&*message.topic);
                    if !is_latched && spans.doubles(message.log_time_ns) {
                        return Ok(true);
                    }
                    if state_topics.contains(&&*message.topic) {
                        recording.take_state(&message, settings)?;
                    }
                    recording.take(&message, settings, space, broken)
                });
            match read {
                Ok(true) => {}
                Ok(false) => skipped += 1,
                Err(UnusableBag::Lacks(what)) => {
                    unreadable.entry(topic).or_insert((0, what)).0 += 1;
                }
                Err(other) => return Err(other),
            }
        }
        recording
            .actions
            .sort(space)
            .map_err(UnusableBag::Differs)?;
        for (count, first) in unreadable.into_values() {
            recording
                .complaints
                .push((count, Thing::Message, format!("cannot be read: {first}")));
        }
        if spans.doubled > 0 {
            let what = "the recorder's clock was set back, so their order is unknown";
            recording
                .complaints
                .push((spans.doubled, Thing::Message, what.to_owned()));
        }
        if skipped > 0 {
            let what = format!("cannot be decoded: {}", broken.reasons());
            recording.complaints.push((skipped, Thing::Picture, what));
        }
        recording.finish(settings)
    }

    /// Ends a piece of the recording at the next picture.
    fn cut(&mut self) {
        self.breaks.push(self.place());
    }

    /// Index of the first camera's next picture.
    fn place(&self) -> usize {
        self.streams.first().map_or(0, |main| main.pictures.len())
    }

    /// Adds a message with the arm's state, for the audit.
    fn take_state(&mut self, message: &BagMessage, settings: &Settings) -> Result<(), UnusableBag> {
        let recorded = &mut self.recorded;
        let at_ns = |header_ns| {
            let stamps = Stamps::of_bag(message, header_ns);
            recorded.state(&message.topic, stamps);
            settings.stamps.of(stamps)
        };
        let taken = self.state.take(message, at_ns);
        taken.map_err(|error| UnusableBag::Lacks(error.to_string()))
    }

    /// Adds a message; `false` for a picture known to be broken.
    fn take(
        &mut self,
        message: &BagMessage,
        settings: &Settings,
        space: &ActionSpace,
        broken: &BrokenPictures,
    ) -> Result<bool, UnusableBag> {
        let topic = &*message.topic;
        let place = self.place();
        let at = |what: String| format!("{topic} at {} ns: {what}", message.log_time_ns);
        let lacks = |error: BagError| UnusableBag::Lacks(at(error.to_string()));
        if settings.cut_topics.iter().any(|name| name == topic) {
            self.cuts.push(place);
        }
        if topic == settings.action_topic {
            let recorded = &mut self.recorded.actions;
            let pushed = self.actions.push(message, space, |header_ns| {
                let stamps = Stamps::of_bag(message, header_ns);
                recorded.push(stamps);
                settings.stamps.of(stamps)
            });
            pushed.map_err(|unusable| unusable.map(at))?;
        }
        if topic == INSTRUCTION && *message.type_name == Text::ros_name() {
            let text: Text = message.decode().map_err(lacks)?;
            self.instructions.push((place, text.data));
        }
        if topic == SUCCESS && *message.type_name == Bool::ros_name() {
            let success: Bool = message.decode().map_err(lacks)?;
            self.successes.push((place, success.data));
        }
        if topic == LABELS && *message.type_name == LabelInfo::ros_name() {
            let labels: LabelInfo = message.decode().map_err(lacks)?;
            let classes = labels.class_map.into_iter();
            // A mask has one byte per pixel.
            let classes = classes
                .filter_map(|class| Some((class.class_id.try_into().ok()?, class.class_name)));
            self.labels.push((place, classes.collect()));
        }
        let stream = self.streams.iter_mut().enumerate();
        if let Some((view, stream)) = stream.into_iter().find(|(_, s)| s.topic == topic) {
            let frame =
                CameraMessage::of_bag(message).map_err(|what| UnusableBag::Lacks(at(what)))?;
            let stamps = Stamps::of_bag(message, frame.header().stamp.to_nanos());
            let stamp_ns = settings.stamps.of(stamps);
            if broken.contains(topic, stamp_ns) {
                return Ok(false);
            }
            if stream.pictures.is_empty() {
                // Reports unsupported formats now rather than after hours of decoding.
                frame
                    .check_format()
                    .map_err(|what| UnusableBag::Lacks(at(what)))?;
                if !frame.begins() {
                    stream.before_keyframe += 1;
                    return Ok(true);
                }
            }
            if topic != MASK {
                let size = frame.size();
                let bytes = (frame.fingerprint(), size);
                self.recorded.picture(view, (stamps, stamp_ns), bytes, None);
                if stream.resize(size) {
                    self.breaks.push(place);
                }
            }
            stream.push(stamp_ns, message.log_time_ns);
        }
        Ok(true)
    }

    fn finish(mut self, settings: &Settings) -> Result<Self, UnusableBag> {
        if settings.stamps == StampSource::Header {
            self.expect_usable_stamps()?;
        }
        for stream in &self.streams {
            if stream.resizes > MOST_RESIZES && stream.resizes * 10 > stream.pictures.len() {
                let what = format!(
                    "the size of the pictures on {} changes {} times: expected one camera on this topic",
                    stream.topic, stream.resizes
                );
                return Err(UnusableBag::Lacks(what));
            }
        }
        for stream in &self.streams {
            if stream.pictures.is_empty() {
                let why = self.complaints.iter();
                let why = why
                    .clone()
                    .find(|(_, _, what)| what.contains(&stream.topic))
                    .or_else(|| why.clone().next());
                let why = why.map_or(String::new(), |(_, _, what)| format!(" ({what})"));
                let what = format!("no camera: no usable frame on {}{why}", stream.topic);
                return Err(UnusableBag::Lacks(what));
            }
            if stream.before_keyframe > 0 {
                let what = format!("come before the first keyframe on {}", stream.topic);
                self.complaints
                    .push((stream.before_keyframe, Thing::Picture, what));
            }
            if stream.unordered > 0 {
                let what = format!(
                    "the stamps on {} are not later than the one before",
                    stream.topic
                );
                self.complaints
                    .push((stream.unordered, Thing::Picture, what));
            }
        }
        if let Some((count, first)) = self.actions.implausible() {
            let what = format!(
                "implausible, excluded with the frames around them: {} {first}",
                self.action_topic
            );
            self.complaints.push((count as u64, Thing::Action, what));
        }
        if self.actions.is_empty() {
            let complaints = self.complaints.iter();
            let of_actions = |thing: &Thing| matches!(thing, Thing::Action | Thing::Message);
            let complaints = complaints.filter(|(_, thing, _)| of_actions(thing));
            let reasons = complaints.map(|(count, thing, what)| {
                let count = usize::try_from(*count).unwrap_or(usize::MAX);
                format!(
                    "; {}: {what}",
                    super::manifest::counted(count, thing.name())
                )
            });
            let mut what = no_actions(&self.action_topic) + &reasons.collect::<String>();
            if self.actions.implausible().is_some() {
                what += "; describe positions, or values in another unit, with --action-space FILE";
            }
            return Err(UnusableBag::Lacks(what));
        }
        Ok(self)
    }

    /// Rejects stamps that are all equal: they would leave one frame of a recording.
    fn expect_usable_stamps(&self) -> Result<(), UnusableBag> {
        let cameras = self.recorded.cameras.iter().map(|camera| &camera.clocks);
        let mut clocks = cameras.chain([&self.recorded.actions]);
        let unusable = clocks.find_map(|clocks| clocks.unusable());
        unusable.map_or(Ok(()), |unusable| {
            Err(UnusableBag::Lacks(format!(
                "{unusable}; choose another time: --stamps log (of recording) or --stamps publish"
            )))
        })
    }

    /// Faults of stamps, rate and pictures.
    pub fn findings(
        &self,
        settings: &Settings,
        space: &ActionSpace,
        actions: &ActionTrack,
    ) -> Vec<Finding> {
        let uses_headers = settings.stamps == StampSource::Header;
        let mut findings = self.recorded.check_stamps(uses_headers);
        findings.extend(self.recorded.check_rate(space));
        findings.extend(self.recorded.check_pictures(actions));
        findings
    }

    /// Cameras without their transports.
    pub fn cameras(&self) -> Vec<String> {
        let cameras = self.streams.iter().take(self.views());
        cameras.map(|s| base(&s.topic).to_owned()).collect()
    }

    /// Number of cameras.
    pub fn views(&self) -> usize {
        self.streams.len() - usize::from(self.has_masks)
    }
}

/// Whether `topic` has joints.
pub(super) fn has_joints(reader: &BagReader, topic: &str) -> bool {
    let topic = reader.topic(topic);
    topic.is_some_and(|topic| *topic.type_name == *JointState::ros_name())
}

/// Topics with the arm's state, except the action topic.
fn state_topics(reader: &BagReader, action_topic: &str) -> Vec<&'static str> {
    let has = |name: &&str| {
        reader.topic(name).is_some_and(|topic| {
            let type_name = &*topic.type_name;
            let has_state =
                type_name == PoseStamped::ros_name() || type_name == JointState::ros_name();
            topic.message_count > 0 && has_state && *name != action_topic
        })
    };
    let pose = POSE_TOPICS.into_iter().find(has);
    pose.into_iter()
        .chain(Some(JOINTS_TOPIC).filter(has))
        .collect()
}

fn no_actions(topic: &str) -> String {
    format!("no actions: expected messages on {topic}")
}

fn check_actions(reader: &BagReader, topic: &str) -> Result<(), String> {
    let info = reader.topic(topic).filter(|info| info.message_count > 0);
    let Some(info) = info else {
        let is_read =
            |other: &&TopicInfo| other.message_count > 0 && ActionLog::reads(&other.type_name);
        let others = reader.topics().iter().filter(is_read);
        let others: Vec<&str> = others.map(|other| other.name.as_ref()).collect();
        let missing = no_actions(topic);
        return Err(match others.as_slice() {
            [] => format!("{missing}; no topic of the bag has {}", ActionLog::types()),
            others => format!("{missing}; --action-topic could be {}", others.join(" or ")),
        });
    };
    if ActionLog::reads(&info.type_name) {
        return Ok(());
    }
    Err(format!(
        "{topic} has the type {}; expected {}",
        info.type_name,
        ActionLog::types()
    ))
}

impl Stream {
    fn new(topic: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            pictures: Vec::new(),
            unordered: 0,
            size: None,
            resizes: 0,
            before_keyframe: 0,
        }
    }

    /// Whether the size differs from the previous picture's.
    fn resize(&mut self, size: Option<(u32, u32)>) -> bool {
        // The decoder finds unknown sizes.
        let Some(size) = size else { return false };
        let before = self.size.replace(size);
        let is_other = before.is_some_and(|before| before != size);
        self.resizes += usize::from(is_other);
        is_other
    }

    fn push(&mut self, stamp_ns: i64, logged_ns: u64) {
        let last = self.pictures.last();
        if last.is_some_and(|last| stamp_ns <= last.stamp_ns) {
            self.unordered += 1;
        } else {
            self.pictures.push(Picture {
                stamp_ns,
                logged_ns,
            });
        }
    }

    /// The picture nearest to a time, at most `most_ns` from it.
    pub fn nearest(&self, stamp_ns: i64, most_ns: i64) -> Option<Picture> {
        let after = self.pictures.partition_point(|p| p.stamp_ns < stamp_ns);
        let near = self.pictures.get(after.saturating_sub(1)..)?.iter().take(2);
        let distance = |picture: &&Picture| picture.stamp_ns.abs_diff(stamp_ns);
        let nearest = near.min_by_key(distance)?;
        (distance(&nearest) <= most_ns.unsigned_abs()).then_some(*nearest)
    }
}
