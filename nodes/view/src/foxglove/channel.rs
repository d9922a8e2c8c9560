//! Channels: offered topics that exist.

use super::{
    message::{ChannelAdvert, SCHEMA_ENCODING},
    offer::Offer,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use wm_bag::Schema;
use wm_ros::{Durability, TopicInfo};

/// The most channels; more topics are hardly meant well.
const MOST: usize = 2000;

/// A topic with its type.
#[derive(Debug)]
pub(crate) struct Channel {
    /// Never reused: a topic that returns gets a new number.
    pub id: u32,
    /// The absolute name.
    pub topic: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// The shortest time between messages.
    pub period: Option<Duration>,
    schema: Arc<Schema>,
    latches: AtomicBool,
}

impl Channel {
    pub(crate) fn advertised(&self) -> ChannelAdvert<'_> {
        ChannelAdvert::new(self.id, &self.topic, &self.type_name, &self.schema.text)
    }

    /// Whether a publisher latches its messages for late subscribers.
    pub(crate) fn latches(&self) -> bool {
        self.latches.load(Ordering::Relaxed)
    }
}

#[derive(Debug, Default)]
pub(crate) struct Channels {
    by_id: BTreeMap<u32, Arc<Channel>>,
    last_id: u32,
    /// Definitions of the types; `None` for unknown types.
    schemas: BTreeMap<String, Option<Arc<Schema>>>,
}

impl Channels {
    pub(crate) fn get(&self, id: u32) -> Option<&Arc<Channel>> {
        self.by_id.get(&id)
    }

    /// By number.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Arc<Channel>> {
        self.by_id.values()
    }

    /// Takes the topics of the graph. `define` returns the definition of a type; without one, viewers cannot read a
    /// topic, so it is not offered. Returns the channels that have gone, and whether any changed.
    pub(crate) fn update(
        &mut self,
        topics: &[TopicInfo],
        offer: &Offer,
        define: impl Fn(&str) -> Option<Schema>,
    ) -> (Vec<u32>, bool) {
        let offered: Vec<&TopicInfo> = topics.iter().filter(|topic| offer.has(topic)).collect();
        let types: BTreeSet<&str> = offered.iter().map(|topic| &*topic.type_name).collect();
        self.schemas.retain(|name, _| types.contains(&**name));
        let there: BTreeMap<(&str, &str), &TopicInfo> = offered
            .iter()
            .map(|topic| ((&*topic.name, &*topic.type_name), *topic))
            .collect();
        let mut gone = Vec::new();
        self.by_id.retain(|id, channel| {
            let topic = there.get(&(&*channel.topic, &*channel.type_name));
            match topic {
                Some(topic) => channel.latches.store(is_latching(topic), Ordering::Relaxed),
                None => gone.push(*id),
            }
            topic.is_some()
        });
        // each name has one type: if the graph has two, the first one stays
        let mut known: BTreeSet<String> =
            self.iter().map(|channel| channel.topic.clone()).collect();
        let mut has_new = false;
        for topic in offered {
            if known.len() >= MOST {
                break;
            }
            if known.contains(&topic.name) {
                continue;
            }
            let schema = self.schemas.entry(topic.type_name.clone());
            let schema = schema.or_insert_with_key(|name| {
                let schema = define(name);
                let schema = schema.filter(|schema| schema.encoding.as_str() == SCHEMA_ENCODING);
                schema.map(Arc::new)
            });
            let Some(schema) = schema.clone() else {
                continue;
            };
            self.last_id += 1;
            let channel = Channel {
                id: self.last_id,
                topic: topic.name.clone(),
                type_name: topic.type_name.clone(),
                period: offer.period(&topic.name),
                schema,
                latches: is_latching(topic).into(),
            };
            self.by_id.insert(channel.id, Arc::new(channel));
            known.insert(topic.name.clone());
            has_new = true;
        }
        let has_changed = has_new || !gone.is_empty();
        (gone, has_changed)
    }
}

fn is_latching(topic: &TopicInfo) -> bool {
    let mut offered = topic.publishers.iter();
    offered.any(|qos| qos.durability == Durability::TransientLocal)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use wm_ros::Qos;

    const TEXT: &str = "std_msgs/msg/String";

    pub(crate) fn channel(topic: &str, period: Option<Duration>, latches: bool) -> Channel {
        Channel {
            id: 1,
            topic: topic.to_owned(),
            type_name: TEXT.to_owned(),
            period,
            schema: Arc::new(Schema::ros2msg("string data\n")),
            latches: latches.into(),
        }
    }

    fn topic(name: &str, type_name: &str, qos: Qos) -> TopicInfo {
        TopicInfo {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            publishers: vec![qos],
            subscribers: 0,
        }
    }

    fn define(type_name: &str) -> Option<Schema> {
        (type_name == TEXT).then(|| Schema::ros2msg("string data\n"))
    }

    #[test]
    fn channels_follow_topics_and_numbers_are_not_reused() {
        let offer = Offer::new(".*", "", &[]).unwrap().unwrap();
        let mut channels = Channels::default();
        let (a, b) = (
            topic("/a", TEXT, Qos::reliable(1)),
            topic("/b", TEXT, Qos::latched(1)),
        );
        let mut update = |topics: &[TopicInfo]| {
            let (gone, has_changed) = channels.update(topics, &offer, define);
            let there = channels
                .iter()
                .map(|channel| (channel.id, channel.topic.clone(), channel.latches()))
                .collect::<Vec<_>>();
            (gone, has_changed, there)
        };
        let of_a = (1, "/a".to_owned(), false);
        let of_b = (2, "/b".to_owned(), true);
        let both = [a.clone(), b.clone()];
        assert_eq!(update(&both), (vec![], true, vec![of_a, of_b.clone()]));
        assert!(!update(&both).1);
        assert_eq!(
            update(std::slice::from_ref(&b)),
            (vec![1], true, vec![of_b.clone()])
        );
        let again = (3, "/a".to_owned(), true);
        let latched = topic("/a", TEXT, Qos::latched(1));
        assert_eq!(update(&[latched, b]), (vec![], true, vec![of_b, again]));
    }

    #[test]
    fn topic_has_one_type_with_a_definition() {
        let offer = Offer::new(".*", "", &[]).unwrap().unwrap();
        let mut channels = Channels::default();
        let unknown = topic("/a", "a/msg/Unknown", Qos::reliable(1));
        assert!(
            !channels
                .update(std::slice::from_ref(&unknown), &offer, define)
                .1
        );
        let known = topic("/a", TEXT, Qos::reliable(1));
        let both = [unknown, known];
        assert!(channels.update(&both, &offer, define).1);
        let types: Vec<_> = channels
            .iter()
            .map(|channel| channel.type_name.clone())
            .collect();
        assert_eq!(types, [TEXT]);
    }

    #[test]
    fn channels_are_bounded() {
        let offer = Offer::new(".*", "", &[]).unwrap().unwrap();
        let mut channels = Channels::default();
        let topics: Vec<_> = (0..MOST + 10)
            .map(|n| topic(&format!("/t{n}"), TEXT, Qos::reliable(1)))
            .collect();
        channels.update(&topics, &offer, define);
        assert_eq!(channels.iter().count(), MOST);
    }
}
