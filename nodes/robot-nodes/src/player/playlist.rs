//! The topics of a bag that are played, and their publishers.

use super::{Settings, chunks::ActionChunks, restamp::StampPlace};
use crate::qos_overrides::KEEP_ALL_DEPTH;
use anyhow::{Context as _, Result, bail};
use std::collections::HashMap;
use std::sync::Arc;
use tracing::warn;
use wm_bag::{BagReader, QosProfile, TopicInfo, kept_messages};
use wm_camera::goal::{camera_topic, last_frame};
use wm_msgs::{
    Message as _,
    sensor_msgs::{CompressedImage, Image},
    wm_msgs::Action,
};
use wm_ros::{Durability, Node, Qos, RawPublisher, Reliability};

/// A topic that is played.
pub(super) struct Track {
    pub publisher: RawPublisher,
    /// Where its messages have their stamps; `None` if stamps are not changed.
    pub stamp_place: Option<StampPlace>,
    /// Whether its messages are pictures.
    pub is_camera: bool,
    /// Whether reliable subscribers acknowledge its messages.
    pub is_reliable: bool,
    /// Whether `/clock` is published before each of its messages.
    pub is_clocked: bool,
}

/// All that is played of a bag.
pub(super) struct Playlist {
    pub tracks: HashMap<Arc<str>, Track>,
    /// The bag's actions, with the parameter `action_chunk_length`.
    pub chunks: Option<ActionChunks>,
    /// The bag's last frame, with the parameter `goal`.
    pub goal: Option<CompressedImage>,
}

impl Playlist {
    /// Creates the publishers, and reads the actions and the goal from the bag. It blocks.
    pub fn new(reader: &BagReader, settings: &Settings, node: &Node) -> Result<Self> {
        for topic in settings
            .topics
            .named()
            .iter()
            .chain(&settings.parameters.clock_topics)
            .filter(|topic| reader.topic(topic).is_none())
        {
            warn!("the bag has no topic {topic}");
        }
        let mut tracks = HashMap::new();
        for topic in reader
            .topics()
            .iter()
            .filter(|topic| settings.plays(&topic.name))
        {
            let stamp_place = StampPlace::of(&topic.type_name, &topic.schema);
            if settings.parameters.is_restamping && stamp_place.is_none() {
                tracing::debug!(
                    "{}: {} has no header: nothing to restamp",
                    topic.name,
                    topic.type_name
                );
            }
            let mut qos = match settings.qos_overrides.get(topic.name.as_ref()) {
                Some(qos) => *qos,
                None => topic
                    .qos()
                    .map_or(Qos::reliable(10), |profile| offered(&profile)),
            };
            if qos.durability == Durability::TransientLocal {
                // Several nodes publish static frames, but one player publishes all of them.
                // It saturates; the depth is bounded below.
                let recorded = usize::try_from(topic.message_count).unwrap_or(usize::MAX);
                qos.depth = qos.depth.max(recorded.min(kept_messages(&topic.name)));
            }
            // Recordings also contain service events and action feedback, whose types are not messages of a package.
            if !topic.type_name.contains("/msg/") {
                warn!("{}: {} is not played", topic.name, topic.type_name);
                continue;
            }
            // a bag without the definition is played under the suite's
            if let Ok(Some(description)) = topic.schema.description(&topic.type_name) {
                node.describe_type(&description);
            }
            let publisher = match node.raw_publisher(&topic.name, &topic.type_name, qos) {
                Ok(publisher) => publisher,
                // Some bags have names that ROS does not allow.
                Err(wm_ros::Error::Name { kind, reason, .. }) => {
                    let name = &topic.name;
                    warn!("{name} is not played: not a valid {kind} name: {reason}");
                    continue;
                }
                Err(error) => {
                    return Err(error).with_context(|| format!("topic {} of the bag", topic.name));
                }
            };
            let track = Track {
                publisher,
                stamp_place: stamp_place.filter(|_| settings.parameters.is_restamping),
                is_camera: [Image::ros_name(), CompressedImage::ros_name()]
                    .iter()
                    .any(|name| *name == *topic.type_name),
                is_reliable: qos.reliability == Reliability::Reliable,
                is_clocked: settings.clocks(&topic.name),
            };
            tracks.insert(topic.name.clone(), track);
        }
        if tracks.is_empty() {
            let names: Vec<&str> = reader
                .topics()
                .iter()
                .map(|topic| topic.name.as_ref())
                .collect();
            bail!(
                "nothing to play in {}; its topics: {}",
                reader.path().display(),
                names.join(", ")
            );
        }
        let chunks = match settings.parameters.chunk_length {
            0 => None,
            length => Some(read_chunks(reader, settings, length)?),
        };
        let goal = if settings.parameters.has_goal {
            Some(last_frame(
                reader,
                &camera_topic(reader, &settings.parameters.camera_topic)?,
            )?)
        } else {
            None
        };
        Ok(Self {
            tracks,
            chunks,
            goal,
        })
    }
}

/// Checks that a bag has actions on this topic.
///
/// # Errors
/// It has none. The error names the topics with actions.
pub(super) fn require_actions(reader: &BagReader, topic: &str) -> Result<()> {
    let is_of_actions = |info: &&TopicInfo| info.type_name.as_ref() == Action::ros_name();
    if reader.topic(topic).as_ref().is_some_and(is_of_actions) {
        return Ok(());
    }
    let others = reader.topics().iter().filter(is_of_actions);
    let others: Vec<&str> = others.map(|info| info.name.as_ref()).collect();
    let others = match others.as_slice() {
        [] => "it has none on any topic".to_owned(),
        others => format!("it has them on: {}", others.join(", ")),
    };
    bail!(
        "the bag {} has no actions ({}) on {topic}; {others}",
        reader.path().display(),
        Action::ros_name(),
    );
}

fn read_chunks(reader: &BagReader, settings: &Settings, length: usize) -> Result<ActionChunks> {
    let topic = settings.parameters.action_topic.as_str();
    require_actions(reader, topic)?;
    // The player reports unreadable parts of the bag.
    let mut actions = Vec::new();
    for message in reader.messages().only_topics([topic]).flatten() {
        match message.decode::<Action>() {
            Ok(action) => actions.push((message.log_time_ns, action)),
            Err(problem) => warn!("action not used in the chunks: {problem}"),
        }
    }
    Ok(ActionChunks::new(actions, length)?)
}

/// The QoS of the bag's publisher, with a bounded depth.
fn offered(profile: &QosProfile) -> Qos {
    let depth = match usize::try_from(profile.depth) {
        Ok(depth @ 1..) => depth.min(KEEP_ALL_DEPTH),
        _ => KEEP_ALL_DEPTH,
    };
    Qos {
        reliability: match profile.reliability {
            wm_bag::Reliability::BestEffort => Reliability::BestEffort,
            wm_bag::Reliability::Reliable => Reliability::Reliable,
        },
        durability: match profile.durability {
            wm_bag::Durability::TransientLocal => Durability::TransientLocal,
            wm_bag::Durability::Volatile => Durability::Volatile,
        },
        depth,
    }
}
