//! The audit of one bag, in one pass; pictures are not kept.

use std::{collections::BTreeMap, sync::Arc};

use wm_bag::{BagMessage, BagReader, TopicInfo};
use wm_camera::{
    camera_frame::CameraFrame,
    signature::Signature,
    transport::{Transport, base},
};
use wm_motion::{
    actions::ActionSpace,
    motion::{Motion, MotionSettings, Pace},
};
use wm_msgs::{Message as _, geometry_msgs::PoseStamped, sensor_msgs::JointState, wm_msgs::Action};

use crate::{
    Audit, BagFindings, Episode, Episodes, Finding, Stamps, StateLog,
    recorded::{ActionTrack, RecordedTopics},
    state::{JOINTS_TOPIC, POSE_TOPICS},
};

/// Default camera for comparison with actions.
const CAMERA: &str = "/camera/image_raw";
/// Default topic of the actions.
const ACTION: &str = "/wm/action";
/// Prefixes of picture topics that are not cameras: the suite's own, and the simulator's masks.
const NOT_CAMERAS: [&str; 2] = ["/wm/", "/camera/mask"];
/// Limit of actions: an hour at 100 Hz.
const ACTIONS_LIMIT: usize = 360_000;
/// Limit of frames that are compared with actions: an hour at 30 Hz.
const FRAMES_LIMIT: usize = 108_000;
/// Gap that ends an episode, as in data sets \[periods\].
const GAP_PERIODS: f64 = 1.75;

/// Whether this build can decode video topics (feature `video`).
pub const JUDGES_VIDEO: bool = cfg!(feature = "video");

/// The topics to audit; others are found in the bag.
#[derive(Clone, Debug, Default)]
pub struct Topics {
    /// Cameras, with or without the ending of their transport.
    pub cameras: Vec<String>,
    /// Actions (wm_msgs/Action).
    pub actions: Option<String>,
}

/// A frame for comparison with actions.
struct Frame {
    at_ns: i64,
    motion: Option<f32>,
}

struct BagAudit {
    recorded: RecordedTopics,
    cameras: Vec<String>,
    state_topics: Vec<String>,
    action_topic: String,
    space: ActionSpace,
    state: StateLog,
    /// Stamp \[ns\] and values.
    actions: Vec<(i64, Vec<f32>)>,
    frames: Vec<Frame>,
    pace: Pace,
    /// Signature of the last frame.
    shown: Option<Signature>,
    #[cfg(feature = "video")]
    videos: video::Videos,
    /// Number of unreadable messages, and the first reason, by topic.
    unreadable: BTreeMap<Option<Arc<str>>, (u64, String)>,
    unfit: (u64, Option<String>),
}

/// Audits cameras, actions and state of a bag in one pass; calls `each` after each message.
#[must_use]
pub fn audit_bag(reader: &BagReader, topics: &Topics, mut each: impl FnMut()) -> Audit {
    let mut all = Vec::new();
    let space = ActionSpace::of_note(reader.note(ActionSpace::NOTE)).unwrap_or_else(|error| {
        let what = format!("the bag's note of its action space cannot be read: {error}");
        all.push(Finding::warning("actions", what));
        ActionSpace::bridge()
    });
    let cameras = select_cameras(reader, &topics.cameras, JUDGES_VIDEO, &mut all);
    let action_topic = select_action_topic(reader, topics.actions.as_deref(), &mut all);
    let period_ns = (1e9 / space.rate()) as i64;
    let has = |name: &&str| {
        reader.topic(name).is_some_and(|topic| {
            let type_name = &*topic.type_name;
            topic.message_count > 0
                && (type_name == PoseStamped::ros_name() || type_name == JointState::ros_name())
        })
    };
    let pose = POSE_TOPICS.into_iter().find(has);
    let joints = Some(JOINTS_TOPIC).filter(has);
    let mut reading = BagAudit {
        #[cfg(feature = "video")]
        videos: video::Videos::of(reader, &cameras),
        recorded: RecordedTopics::new(cameras.iter().map(String::as_str), &action_topic),
        cameras,
        state_topics: pose.into_iter().chain(joints).map(str::to_owned).collect(),
        action_topic,
        space,
        state: StateLog::default(),
        actions: Vec::new(),
        frames: Vec::new(),
        // The camera's period is not known yet: frames may be a quarter of a period early.
        pace: Pace::new(period_ns, period_ns / 2),
        shown: None,
        unreadable: BTreeMap::new(),
        unfit: (0, None),
    };
    let wanted = reading.cameras.iter().chain(&reading.state_topics);
    let wanted: Vec<String> = wanted.chain([&reading.action_topic]).cloned().collect();
    for message in reader.messages().only_topics(wanted) {
        let topic = message.as_ref().ok().map(|m| Arc::clone(&m.topic));
        let taken = message.map_err(|error| error.to_string());
        if let Err(reason) = taken.and_then(|message| reading.take(&message)) {
            reading.unreadable.entry(topic).or_insert((0, reason)).0 += 1;
        }
        each();
    }
    reading.finish(all)
}

/// The cameras of a bag: compressed, then raw, then video.
fn list_cameras(reader: &BagReader) -> Vec<(Transport, String)> {
    let topics = reader.topics().iter().filter(|topic| {
        topic.message_count > 0
            && !NOT_CAMERAS
                .iter()
                .any(|other| topic.name.starts_with(other))
    });
    let transports = topics.filter_map(|topic| {
        let transport = Transport::of(&topic.name, &topic.type_name)?;
        Some((transport, topic.name.to_string()))
    });
    let mut found: Vec<(Transport, String)> = transports.collect();
    found.sort_by_key(|(transport, _)| match transport {
        Transport::Compressed => 0,
        Transport::Raw => 1,
        _ => 2,
    });
    found
}

/// The video topics of a bag whose camera has no other transport.
#[must_use]
pub fn video_topics(reader: &BagReader) -> Vec<String> {
    let found = list_cameras(reader);
    let has_stills = |camera: &str| {
        let mut others = found.iter().filter(|(transport, _)| transport.is_read());
        others.any(|(_, name)| base(name) == camera)
    };
    let video = found
        .iter()
        .filter(|(transport, name)| *transport == Transport::Video && !has_stills(base(name)));
    video.map(|(_, name)| name.clone()).collect()
}

/// The cameras of a bag, first the one for comparison with actions.
fn select_cameras(
    reader: &BagReader,
    named: &[String],
    judges_video: bool,
    findings: &mut Vec<Finding>,
) -> Vec<String> {
    let is_named = |name: &String| {
        let camera = base(name);
        named.is_empty() || named.iter().any(|named| base(named) == camera)
    };
    // Several transports send the same pictures: use the first.
    let mut found: Vec<String> = Vec::new();
    for (transport, name) in list_cameras(reader) {
        let is_judged = transport.is_read() || judges_video && transport == Transport::Video;
        if is_judged && !found.iter().any(|other| base(other) == base(&name)) {
            found.push(name);
        }
    }
    let mut unjudged = Vec::new();
    if !judges_video {
        unjudged = video_topics(reader);
        unjudged.retain(is_named);
    }
    findings.extend(unjudged.iter().map(|name| {
        let what = format!("not judged: {name} is compressed video, and wm has no decoder for it");
        Finding::note("camera", what)
            .fix("build the program with the decoder, which wm bag info --audit then starts: cargo build --release -p wm_import")
    }));
    found.sort_by_key(|name| (base(name) != CAMERA, name.clone()));
    if named.is_empty() {
        if found.is_empty() && unjudged.is_empty() {
            findings.push(missing_camera(reader));
        }
        return found;
    }
    let named = named.iter().filter_map(|name| {
        let of = found
            .iter()
            .find(|found| *found == name || base(found) == base(name));
        let is_unjudged = unjudged.iter().any(|other| base(other) == base(name));
        if of.is_none() && !is_unjudged {
            let what = format!("no pictures on {name}; the bag has {}", found.join(", "));
            findings.push(Finding::error("camera", what));
        }
        of.cloned()
    });
    named.collect()
}

/// The finding for a bag without readable pictures.
fn missing_camera(reader: &BagReader) -> Finding {
    let topics = reader
        .topics()
        .iter()
        .filter(|topic| topic.message_count > 0);
    let mut unread = topics.filter_map(|topic| {
        let transport = Transport::of(&topic.name, &topic.type_name)?;
        transport.advice(&topic.name)
    });
    let finding = Finding::error("camera", "no pictures on any topic");
    match unread.next() {
        Some(advice) => finding.fix(advice),
        None => finding,
    }
}

fn select_action_topic(
    reader: &BagReader,
    named: Option<&str>,
    findings: &mut Vec<Finding>,
) -> String {
    let has_actions =
        |topic: &&TopicInfo| topic.message_count > 0 && *topic.type_name == Action::ros_name();
    let found: Vec<&str> = reader
        .topics()
        .iter()
        .filter(has_actions)
        .map(|topic| &*topic.name)
        .collect();
    let wanted = named.unwrap_or(ACTION);
    if found.contains(&wanted) {
        return wanted.to_owned();
    }
    match (named, found.as_slice()) {
        (None, [only]) => (*only).to_owned(),
        _ => {
            let others = match found.as_slice() {
                [] => format!("no topic of the bag has {}", Action::ros_name()),
                found => format!("choose with --action: {}", found.join(", ")),
            };
            let what = format!("no actions on {wanted}; {others}");
            findings.push(Finding::note("actions", what));
            wanted.to_owned()
        }
    }
}

impl BagAudit {
    fn take(&mut self, message: &BagMessage) -> Result<(), String> {
        let topic = &*message.topic;
        let words = |error: wm_bag::BagError| error.to_string();
        let stamps = |header_ns| Stamps::of_bag(message, header_ns);
        if let Some(camera) = self.cameras.iter().position(|name| name == topic) {
            #[cfg(feature = "video")]
            if self.videos.has(camera) {
                return self.take_packet(camera, message);
            }
            let frame = CameraFrame::of_bag(message).map_err(words)?;
            let at_ns = frame.header().stamp.to_nanos();
            let picture = frame.decode().map_err(|error| format!("{topic}: {error}"));
            let signature = picture.as_ref().ok().map(Signature::of);
            let size = signature
                .as_ref()
                .map(Signature::size)
                .or_else(|| frame.size());
            self.recorded.stamp(camera, stamps(at_ns));
            self.show(camera, at_ns, (frame.fingerprint(), size), signature);
            return picture.map(|_| ());
        }
        if topic == self.action_topic {
            let action: Action = message.decode().map_err(words)?;
            let at_ns = action.header.stamp.to_nanos();
            self.recorded.actions.push(stamps(at_ns));
            if let Err(error) = self.space.check(&action.values) {
                self.unfit.0 += 1;
                self.unfit.1.get_or_insert(error.to_string());
            } else if self.actions.len() < ACTIONS_LIMIT {
                self.actions.push((at_ns, action.values));
            }
            return Ok(());
        }
        let recorded = &mut self.recorded;
        let taken = self.state.take(message, |stamp_ns| {
            recorded.state(topic, stamps(stamp_ns));
            stamp_ns
        });
        taken.map_err(words)
    }

    /// Adds a picture: stamp \[ns\], fingerprint, size \[px\], and signature if it was decoded.
    fn show(
        &mut self,
        camera: usize,
        at_ns: i64,
        (fingerprint, size): (u64, Option<(u32, u32)>),
        signature: Option<Signature>,
    ) {
        if let Some(camera) = self.recorded.cameras.get_mut(camera) {
            let pictures = &mut camera.pictures;
            pictures.push(at_ns, fingerprint, size, signature.clone());
        }
        let is_newer = self.frames.last().is_none_or(|last| at_ns > last.at_ns);
        if camera == 0 && is_newer && self.frames.len() < FRAMES_LIMIT && self.pace.is_due(at_ns) {
            let both = self.shown.as_ref().zip(signature.as_ref());
            let motion = both.and_then(|(before, now)| before.change(now));
            self.frames.push(Frame { at_ns, motion });
            self.shown = signature;
        }
    }

    fn finish(mut self, mut all: Vec<Finding>) -> Audit {
        #[cfg(feature = "video")]
        all.extend(self.finish_videos());
        let mut warn = |check, count: u64, what: String| {
            all.push(Finding::warning(check, what).figure("messages", count as f64));
        };
        for (topic, (count, first)) in &self.unreadable {
            let of = topic
                .as_ref()
                .map_or(String::new(), |topic| format!(" of {topic}"));
            let what = format!("{count} messages{of} cannot be read, the first: {first}");
            warn("frames", *count, what);
        }
        if let (count, Some(first)) = &self.unfit {
            let what = format!("{count} actions do not fit their action space, the first: {first}");
            warn("actions", *count, what);
        }
        self.actions.sort_by_key(|(at_ns, _)| *at_ns);
        let rows = self
            .actions
            .iter()
            .map(|(at_ns, values)| (*at_ns, values.as_slice()));
        let track = ActionTrack::new(&self.space, rows);
        let mut findings: Vec<Finding> = self
            .recorded
            .cameras
            .iter()
            .map(|camera| camera.pictures.summary())
            .collect();
        findings.extend(self.recorded.check_stamps(true));
        findings.extend(self.recorded.check_rate(&self.space));
        findings.extend(self.recorded.check_pictures(&track));
        let camera = self.recorded.cameras.first();
        let gap_s = camera.and_then(|camera| camera.clocks.gaps().median_s());
        // The period is the slower one of camera and actions.
        // Without a gap, the camera has at most one frame.
        let period_s = (1.0 / self.space.rate()).max(gap_s.unwrap_or(0.0));
        if !self.actions.is_empty() && self.frames.len() > 1 {
            let episodes = self.episodes(period_s);
            all.extend(Audit::of_episodes(Episodes {
                episodes: &episodes,
                space: &self.space,
                period_s,
            }));
        }
        let bag = BagFindings {
            bag: String::new(),
            findings,
            sizes: Vec::new(),
        };
        Audit::new(&[bag], all)
    }

    /// Splits the frames at gaps, and assigns to each the actions up to the next frame.
    fn episodes(&mut self, period_s: f64) -> Vec<Episode> {
        let period_ns = (period_s * 1e9) as i64;
        let path = std::mem::take(&mut self.state).path(&self.space);
        let mut motion = Motion::new(MotionSettings::of_period(period_ns));
        let mut actions = self.actions.iter().peekable();
        let mut episodes: Vec<Episode> = Vec::new();
        let mut before_ns: Option<i64> = None;
        let nexts = self.frames.iter().skip(1).map(|frame| Some(frame.at_ns));
        for (frame, next_ns) in self.frames.iter().zip(nexts.chain([None])) {
            let is_near = |to_ns: &i64| {
                to_ns.saturating_sub(frame.at_ns) as f64 <= GAP_PERIODS * period_ns as f64
            };
            let to_ns = next_ns
                .filter(is_near)
                .unwrap_or(frame.at_ns.saturating_add(period_ns));
            let until_ns = to_ns.saturating_add(period_ns);
            while let Some((at_ns, values)) = actions.next_if(|(at_ns, _)| *at_ns <= until_ns) {
                motion.take(*at_ns, Arc::from(values.as_slice()));
            }
            let interval = motion.between(&self.space, frame.at_ns, to_ns);
            let Some(interval) = interval.filter(|interval| interval.is_given) else {
                before_ns = None;
                continue;
            };
            let is_new = before_ns.is_none_or(|before_ns| {
                frame.at_ns.saturating_sub(before_ns) as f64 > GAP_PERIODS * period_ns as f64
            });
            if is_new {
                let name = format!("{}", episodes.len() + 1);
                episodes.push(Episode::new(name, self.space.len()));
            }
            before_ns = Some(frame.at_ns);
            if let Some(episode) = episodes.last_mut() {
                episode.push(&interval.values, frame.motion, Some(&path.at(frame.at_ns)));
            }
        }
        episodes
    }
}

#[cfg(feature = "video")]
mod video;

#[cfg(test)]
mod tests;
