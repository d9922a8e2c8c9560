//! Topics and messages received while listening to the graph.

use crate::{Picture, Timeline, comparison::Comparison};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use wm_ros::Qos;

/// A topic and its messages.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stream {
    /// The absolute name.
    pub topic: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// QoS that each publisher offers.
    pub publishers: Vec<Qos>,
    pub timeline: Timeline,
    /// Messages missing in the publishers' numbering.
    pub lost: u64,
    /// Messages of another type than the topic's.
    pub undecodable: u64,
    /// The error of the first of these.
    pub first_undecodable: Option<String>,
    /// Frames of the headers.
    pub frame_ids: BTreeSet<String>,
    /// The largest message \[byte\].
    pub largest: usize,
}

/// A camera: an image topic, its sibling `/compressed`, or both.
#[derive(Clone, Debug, Default)]
pub struct Camera {
    pub raw: Option<Stream>,
    pub compressed: Option<Stream>,
    /// A few of its pictures, evenly spaced, or the errors of undecodable ones.
    pub pictures: Vec<Result<Picture, String>>,
    /// `encoding` of its raw frames, or `format` of its compressed ones.
    pub encoding: Option<String>,
    /// The comparison of all its pictures.
    pub comparison: Comparison,
}

impl Camera {
    /// Its transports.
    pub fn streams(&self) -> impl Iterator<Item = &Stream> {
        self.raw.iter().chain(&self.compressed)
    }

    /// The transport with more messages.
    #[must_use]
    pub fn best(&self) -> Option<&Stream> {
        self.streams().max_by_key(|stream| stream.timeline.len())
    }
}

/// Actions of a robot, or action chunks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Actions {
    pub stream: Stream,
    /// Whether it carries action chunks of a policy.
    pub is_chunk: bool,
    /// Values of a few actions.
    pub values: Vec<Vec<f32>>,
    /// Stamp \[ns\] and values of many actions.
    pub rows: Vec<(i64, Vec<f32>)>,
}

/// A topic that `wm action_adapter` can convert to actions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Motion {
    pub topic: String,
    pub type_name: String,
    /// The adapter's parameter `source` for it.
    pub source: &'static str,
}

/// Everything received while listening.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    /// Duration of listening.
    pub span: Duration,
    /// Other participants.
    pub participants: usize,
    /// Cameras by topic, without `/compressed`.
    pub cameras: BTreeMap<String, Camera>,
    /// Actions and chunks by topic.
    pub actions: BTreeMap<String, Actions>,
    /// Remedies for image topics that the nodes cannot read.
    pub unread: Vec<String>,
    /// Velocities and poses of an arm.
    pub motions: Vec<Motion>,
    /// The newest time on `/clock` and its arrival \[ns\].
    pub clock_ns: Option<(i64, i64)>,
    /// Reports of running nodes by name: the message, and whether it is an error.
    pub reports: BTreeMap<String, (String, bool)>,
}

impl Survey {
    /// Whether there were no other participants.
    pub(crate) fn is_silent(&self) -> bool {
        self.participants == 0
    }

    /// The camera `wanted`; if `None`, the default one, or the first with pictures.
    #[must_use]
    pub fn camera<'a>(&'a self, wanted: Option<&'a str>) -> Option<(&'a str, &'a Camera)> {
        let found = |(name, camera): (&'a String, &'a Camera)| (name.as_str(), camera);
        if let Some(name) = wanted {
            return self.cameras.get_key_value(name).map(found);
        }
        let works = |(_, camera): &(&String, &Camera)| camera.pictures.iter().any(Result::is_ok);
        let default = self.cameras.get_key_value(DEFAULT_CAMERA).filter(works);
        let first = || {
            self.cameras
                .iter()
                .find(works)
                .or_else(|| self.cameras.iter().next())
        };
        default.or_else(first).map(found)
    }

    /// The actions `wanted`; if `None`, the default ones, or the first that are not chunks.
    #[must_use]
    pub fn actions<'a>(&'a self, wanted: Option<&'a str>) -> Option<(&'a str, &'a Actions)> {
        let found = |(name, actions): (&'a String, &'a Actions)| (name.as_str(), actions);
        if let Some(name) = wanted {
            return self.actions.get_key_value(name).map(found);
        }
        let is_taken = |(_, actions): &(&String, &Actions)| !actions.is_chunk;
        let default = self.actions.get_key_value(DEFAULT_ACTION);
        default
            .or_else(|| self.actions.iter().find(is_taken))
            .map(found)
    }

    /// The arm's topic of this name.
    #[must_use]
    pub fn motion(&self, name: &str) -> Option<&Motion> {
        self.motions.iter().find(|motion| motion.topic == name)
    }

    pub(crate) fn streams(&self) -> impl Iterator<Item = &Stream> {
        let cameras = self.cameras.values().flat_map(Camera::streams);
        cameras.chain(self.actions.values().map(|actions| &actions.stream))
    }
}

/// The nodes' topic without remapping.
pub(crate) const DEFAULT_CAMERA: &str = "/camera/image_raw";
/// The nodes' topic without remapping.
pub(crate) const DEFAULT_ACTION: &str = "/wm/action";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_or_first_working_topic_is_chosen() {
        let works = Camera {
            pictures: vec![Ok(Picture::default())],
            ..Camera::default()
        };
        let mut survey = Survey::default();
        assert!(survey.camera(None).is_none());
        survey.cameras.insert("/a/depth".into(), Camera::default());
        assert_eq!(survey.camera(None).unwrap().0, "/a/depth");
        survey.cameras.insert("/front".into(), works.clone());
        assert_eq!(survey.camera(None).unwrap().0, "/front");
        survey.cameras.insert(DEFAULT_CAMERA.into(), works);
        assert_eq!(survey.camera(None).unwrap().0, DEFAULT_CAMERA);
        assert_eq!(survey.camera(Some("/a/depth")).unwrap().0, "/a/depth");
        assert!(survey.camera(Some("/nope")).is_none());
    }

    #[test]
    fn action_chunks_are_not_used_as_actions() {
        let mut survey = Survey::default();
        let chunk = Actions {
            is_chunk: true,
            ..Actions::default()
        };
        survey.actions.insert("/a/chunk".into(), chunk);
        assert!(survey.actions(None).is_none());
        survey
            .actions
            .insert("/arm/action".into(), Actions::default());
        assert_eq!(survey.actions(None).unwrap().0, "/arm/action");
    }
}
