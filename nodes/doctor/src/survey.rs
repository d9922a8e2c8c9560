//! What was heard in the graph.

use crate::{Picture, Timeline, comparison::Comparison};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use wm_ros::Qos;

/// A topic, and what came on it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stream {
    /// The absolute name.
    pub topic: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// What each publisher offers.
    pub publishers: Vec<Qos>,
    /// The messages.
    pub timeline: Timeline,
    /// Messages that are missing in their publishers' numbers.
    pub lost: u64,
    /// Messages that are not of the type.
    pub undecodable: u64,
    /// What is wrong with the first of these.
    pub first_undecodable: Option<String>,
    /// Frames of the headers.
    pub frame_ids: BTreeSet<String>,
    /// The largest message \[byte\].
    pub largest: usize,
}

/// A camera: an image topic, its sibling `/compressed`, or both.
#[derive(Clone, Debug, Default)]
pub struct Camera {
    /// Raw frames.
    pub raw: Option<Stream>,
    /// Compressed frames.
    pub compressed: Option<Stream>,
    /// A few of its pictures, evenly spaced; or why one is no picture.
    pub pictures: Vec<Result<Picture, String>>,
    /// `encoding` of its raw frames, or `format` of its compressed ones.
    pub encoding: Option<String>,
    /// All of its pictures, compared with each other.
    pub comparison: Comparison,
}

impl Camera {
    /// Its transports.
    pub fn streams(&self) -> impl Iterator<Item = &Stream> {
        self.raw.iter().chain(&self.compressed)
    }

    /// The transport that more came on.
    #[must_use]
    pub fn best(&self) -> Option<&Stream> {
        self.streams().max_by_key(|stream| stream.timeline.len())
    }
}

/// Actions of a robot, or chunks of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Actions {
    /// The topic.
    pub stream: Stream,
    /// Whether it carries chunks, of a policy.
    pub is_chunk: bool,
    /// Values of a few actions.
    pub values: Vec<Vec<f32>>,
    /// Stamp \[ns\] and values of many.
    pub rows: Vec<(i64, Vec<f32>)>,
}

/// What `wm action_adapter` makes actions of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Motion {
    /// The topic.
    pub topic: String,
    /// Its type.
    pub type_name: String,
    /// The adapter's parameter `source` for it.
    pub source: &'static str,
}

/// All that was heard.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// For how long it was listened.
    pub span: Duration,
    /// Other participants.
    pub participants: usize,
    /// Cameras by their topic, without `/compressed`.
    pub cameras: BTreeMap<String, Camera>,
    /// Actions and chunks by their topic.
    pub actions: BTreeMap<String, Actions>,
    /// Remedies for topics with pictures that the nodes do not read.
    pub unread: Vec<String>,
    /// Velocities and poses of an arm.
    pub motions: Vec<Motion>,
    /// The newest time on `/clock` and when it came \[ns\].
    pub clock_ns: Option<(i64, i64)>,
    /// What running nodes report: name and message, whether it is an error.
    pub reports: BTreeMap<String, (String, bool)>,
}

impl Heard {
    /// Whether nobody else was there.
    pub(crate) fn is_silent(&self) -> bool {
        self.participants == 0
    }

    /// The camera of this name, or else the one to begin with: the default, or the first that sends pictures.
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

    /// The actions of this name, or else the ones to begin with: the default, or the first that are no chunks.
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

    /// What an arm publishes under this name.
    #[must_use]
    pub fn motion(&self, name: &str) -> Option<&Motion> {
        self.motions.iter().find(|motion| motion.topic == name)
    }

    /// Every stream that was listened to.
    pub(crate) fn streams(&self) -> impl Iterator<Item = &Stream> {
        let cameras = self.cameras.values().flat_map(Camera::streams);
        cameras.chain(self.actions.values().map(|actions| &actions.stream))
    }
}

/// The nodes' own names, without remapping.
pub(crate) const DEFAULT_CAMERA: &str = "/camera/image_raw";
/// As [`DEFAULT_CAMERA`].
pub(crate) const DEFAULT_ACTION: &str = "/wm/action";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_or_the_first_that_works_is_taken() {
        let works = Camera {
            pictures: vec![Ok(Picture::default())],
            ..Camera::default()
        };
        let mut heard = Heard::default();
        assert!(heard.camera(None).is_none());
        heard.cameras.insert("/a/depth".into(), Camera::default());
        assert_eq!(heard.camera(None).unwrap().0, "/a/depth");
        heard.cameras.insert("/front".into(), works.clone());
        assert_eq!(heard.camera(None).unwrap().0, "/front");
        heard.cameras.insert(DEFAULT_CAMERA.into(), works);
        assert_eq!(heard.camera(None).unwrap().0, DEFAULT_CAMERA);
        assert_eq!(heard.camera(Some("/a/depth")).unwrap().0, "/a/depth");
        assert!(heard.camera(Some("/nope")).is_none());
    }

    #[test]
    fn a_policys_chunks_are_no_actions_that_were_taken() {
        let mut heard = Heard::default();
        let chunk = Actions {
            is_chunk: true,
            ..Actions::default()
        };
        heard.actions.insert("/a/chunk".into(), chunk);
        assert!(heard.actions(None).is_none());
        heard
            .actions
            .insert("/arm/action".into(), Actions::default());
        assert_eq!(heard.actions(None).unwrap().0, "/arm/action");
    }
}
