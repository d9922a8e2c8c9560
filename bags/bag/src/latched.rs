//! What holds until it is replaced: messages of latched topics, which a late subscriber receives too.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use bytes::Bytes;

use crate::QosProfile;

/// Messages of `/tf_static` that are kept: several nodes publish there, each its own frames.
const STATIC_FRAMES: usize = 64;

/// Topics, by the end of their names, that are latched wherever they are published.
const LATCHED: [&str; 8] = [
    "/tf_static",
    "/robot_description",
    "/task/instruction",
    "/task/success",
    "/label_info",
    "/goal/image",
    "/goal/image/compressed",
    "/map",
];

/// The profile of a topic whose recorder wrote none, by what the topic is known for; none for other topics.
#[must_use]
pub fn known_qos(topic: &str) -> Option<QosProfile> {
    let is_known = LATCHED.iter().any(|end| topic.ends_with(end));
    is_known.then(QosProfile::latched)
}

/// How many messages of a latched topic hold at a time.
#[must_use]
pub fn kept_messages(topic: &str) -> usize {
    match topic.ends_with("/tf_static") {
        true => STATIC_FRAMES,
        false => 1,
    }
}

/// The messages of latched topics that hold.
#[derive(Clone, Debug)]
pub struct Latched<T> {
    topics: BTreeMap<Arc<str>, VecDeque<(Bytes, T)>>,
}

impl<T> Default for Latched<T> {
    fn default() -> Self {
        Self {
            topics: BTreeMap::new(),
        }
    }
}

impl<T> Latched<T> {
    /// Takes the next message of a latched topic. It replaces the oldest, or the one with the same bytes.
    pub fn keep(&mut self, topic: &Arc<str>, data: &Bytes, message: T) {
        let kept = self.topics.entry(Arc::clone(topic)).or_default();
        kept.retain(|(known, _)| known != data);
        kept.push_back((data.clone(), message));
        while kept.len() > kept_messages(topic) {
            kept.pop_front();
        }
    }

    /// The messages that hold, topic by topic, in the order in which they came.
    pub fn iter(&self) -> impl Iterator<Item = (&Arc<str>, &T)> {
        let topics = self.topics.iter();
        topics.flat_map(|(topic, kept)| kept.iter().map(move |(_, message)| (topic, message)))
    }

    /// [`iter`](Self::iter), by value.
    pub fn into_messages(self) -> impl Iterator<Item = (Arc<str>, T)> {
        self.topics.into_iter().flat_map(|(topic, kept)| {
            kept.into_iter()
                .map(move |(_, message)| (Arc::clone(&topic), message))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_message_holds_and_static_frames_add_up() {
        let mut latched = Latched::default();
        for (topic, data, number) in [
            ("/tf_static", "a", 1),
            ("/tf_static", "b", 2),
            ("/task/instruction", "push", 3),
            ("/tf_static", "a", 4),
            ("/task/instruction", "pull", 5),
        ] {
            latched.keep(&topic.into(), &Bytes::from_static(data.as_bytes()), number);
        }
        let kept: Vec<_> = latched.into_messages().map(|(_, number)| number).collect();
        assert_eq!(kept, [5, 2, 4]);
    }
}
