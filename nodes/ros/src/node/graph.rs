//! What there is in the graph.

use super::Node;
use crate::{Error, Qos};
use std::collections::BTreeMap;

/// A topic of the graph with one of its types (which, in a graph that is in order, is the only one).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// The absolute name.
    pub name: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// What each publisher offers. Depths are not announced by remote publishers and read as 10.
    pub publishers: Vec<Qos>,
    /// How many subscriptions there are.
    pub subscribers: usize,
}

impl Node {
    /// Every topic that has been seen, this process's own included, by name.
    pub fn topics(&self) -> Vec<TopicInfo> {
        let mut topics: BTreeMap<(String, String), TopicInfo> = BTreeMap::new();
        for seen in self.inner.backend().seen() {
            let key = (seen.name.clone(), seen.type_name.clone());
            let topic = topics.entry(key).or_insert_with(|| TopicInfo {
                name: seen.name,
                type_name: seen.type_name,
                publishers: Vec::new(),
                subscribers: 0,
            });
            if seen.is_writer {
                topic.publishers.push(seen.qos);
            } else {
                topic.subscribers += 1;
            }
        }
        topics.into_values().collect()
    }

    /// How many publishers a topic has.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn count_publishers(&self, topic: &str) -> Result<usize, Error> {
        self.count(topic, true)
    }

    /// How many subscriptions a topic has.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn count_subscribers(&self, topic: &str) -> Result<usize, Error> {
        self.count(topic, false)
    }

    fn count(&self, topic: &str, is_writer: bool) -> Result<usize, Error> {
        let name = self.resolve(topic)?;
        let seen = self.inner.backend().seen();
        Ok(seen
            .iter()
            .filter(|seen| seen.name == name && seen.is_writer == is_writer)
            .count())
    }

    /// Counts changes of the graph: endpoints that come, go, or are connected. Wait with `changed()`.
    pub fn graph_changes(&self) -> tokio::sync::watch::Receiver<u64> {
        self.inner.backend().changes()
    }
}
