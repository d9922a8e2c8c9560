//! Messages of latched topics, which late subscribers receive too.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use bytes::Bytes;

use crate::QosProfile;

/// Limit of `/tf_static` messages: several nodes publish there, each its own frames.
const STATIC_FRAMES: usize = 64;

/// Name endings of topics that are always latched.
const LATCHED_ENDINGS: [&str; 8] = [
    "/tf_static",
    "/robot_description",
    "/task/instruction",
    "/task/success",
    "/label_info",
    "/goal/image",
    "/goal/image/compressed",
    "/map",
];

/// The conventional profile of a topic that was recorded without one; `None` if its name implies nothing.
#[must_use]
pub fn known_qos(topic: &str) -> Option<QosProfile> {
    let is_known = LATCHED_ENDINGS.iter().any(|end| topic.ends_with(end));
    is_known.then(QosProfile::latched)
}

/// Number of messages of a latched topic that a late subscriber receives.
#[must_use]
pub fn kept_messages(topic: &str) -> usize {
    match topic.ends_with("/tf_static") {
        true => STATIC_FRAMES,
        false => 1,
    }
}

/// The messages of latched topics that a late subscriber receives.
#[derive(Clone, Debug)]
pub struct LatchedMessages<T> {
    topics: BTreeMap<Arc<str>, VecDeque<(Bytes, T)>>,
}

impl<T> Default for LatchedMessages<T> {
    fn default() -> Self {
        Self {
            topics: BTreeMap::new(),
        }
    }
}

impl<T> LatchedMessages<T> {
    /// Adds a message of a latched topic. It replaces the oldest one, or the one with the same bytes.
    pub fn add(&mut self, topic: &Arc<str>, data: &Bytes, message: T) {
        let kept = self.topics.entry(Arc::clone(topic)).or_default();
        kept.retain(|(known, _)| known != data);
        kept.push_back((data.clone(), message));
        while kept.len() > kept_messages(topic) {
            kept.pop_front();
        }
    }

    /// The messages, by topic, in the order of their arrival.
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
    fn last_message_replaces_others_except_static_frames() {
        let mut latched = LatchedMessages::default();
        for (topic, data, number) in [
            ("/tf_static", "a", 1),
            ("/tf_static", "b", 2),
            ("/task/instruction", "push", 3),
            ("/tf_static", "a", 4),
            ("/task/instruction", "pull", 5),
        ] {
            latched.add(&topic.into(), &Bytes::from_static(data.as_bytes()), number);
        }
        let kept: Vec<_> = latched.into_messages().map(|(_, number)| number).collect();
        assert_eq!(kept, [5, 2, 4]);
    }
}
