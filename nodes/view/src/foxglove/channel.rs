//! The channels: topics that are offered and there.

use super::{
    message::{Advertised, SCHEMA_ENCODING},
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

/// Channels at a time: whoever makes more topics does not mean well.
const MOST: usize = 2000;

/// A topic with its type.
#[derive(Debug)]
pub struct Channel {
    /// Its number. One that has gone and comes again has another.
    pub id: u32,
    /// The absolute name.
    pub topic: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// The shortest time from one message to the next.
    pub period: Option<Duration>,
    schema: Arc<Schema>,
    latches: AtomicBool,
}

impl Channel {
    /// As it is advertised.
    pub fn advertised(&self) -> Advertised<'_> {
        Advertised::new(self.id, &self.topic, &self.type_name, &self.schema.text)
    }

    /// Whether a publisher latches what it publishes, so that who comes late gets it too.
    pub fn latches(&self) -> bool {
        self.latches.load(Ordering::Relaxed)
    }
}

/// All of them.
#[derive(Debug, Default)]
pub struct Channels {
    by_id: BTreeMap<u32, Arc<Channel>>,
    last_id: u32,
    /// What types of the graph are defined as, and those that are not.
    schemas: BTreeMap<String, Option<Arc<Schema>>>,
}

impl Channels {
    /// The one of this number.
    pub fn get(&self, id: u32) -> Option<&Arc<Channel>> {
        self.by_id.get(&id)
    }

    /// All of them, by number.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<Channel>> {
        self.by_id.values()
    }

    /// Takes the topics of the graph. `define` finds the definition of a type; topics without one are not offered, since no
    /// viewer can read them. Gives the channels that have gone, and whether any came or went.
    pub fn update(
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
        // A name has one type. Where the graph says two, the one that was there first stays.
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
pub mod tests {
    use super::*;
    use wm_ros::Qos;

    const TEXT: &str = "std_msgs/msg/String";

    /// A channel of `topic`.
    pub fn channel(topic: &str, period: Option<Duration>, latches: bool) -> Channel {
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
    fn channels_come_and_go_with_their_topics_and_numbers_are_not_used_again() {
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
    fn a_topic_has_one_type_and_one_that_is_defined() {
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
    fn who_makes_endless_topics_makes_no_endless_channels() {
        let offer = Offer::new(".*", "", &[]).unwrap().unwrap();
        let mut channels = Channels::default();
        let topics: Vec<_> = (0..MOST + 10)
            .map(|n| topic(&format!("/t{n}"), TEXT, Qos::reliable(1)))
            .collect();
        channels.update(&topics, &offer, define);
        assert_eq!(channels.iter().count(), MOST);
    }
}
