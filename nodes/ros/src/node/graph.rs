//! The contents of the graph.

use super::Node;
use crate::{
    Error, Qos,
    backend::{Channel, DiscoveredEndpoint},
};
use std::collections::{BTreeMap, BTreeSet};

/// A topic of the graph with one of its types (in a consistent graph its only type).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// The absolute name.
    pub name: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// The offered QoS of each publisher. Remote publishers do not announce depths; they read as 10.
    pub publishers: Vec<Qos>,
    /// The number of subscriptions.
    pub subscribers: usize,
}

/// The role of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Publishes a topic.
    Publisher,
    /// Subscribes to a topic.
    Subscription,
    /// Answers the calls of a service.
    Server,
    /// Calls a service.
    Client,
}

/// An endpoint in another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteEndpoint {
    /// Its role.
    pub role: Role,
    /// The absolute name of its topic or service.
    pub name: String,
    /// `package/msg/Type`, or `package/srv/Type` for a service.
    pub type_name: String,
    /// The offered or requested QoS. The depth is not announced and reads as 10.
    pub qos: Qos,
    /// The GUID prefix of its participant.
    pub participant: [u8; 12],
}

impl RemoteEndpoint {
    fn of(seen: DiscoveredEndpoint) -> Option<Self> {
        let role = match (seen.channel, seen.is_writer) {
            (Channel::Topic, true) => Role::Publisher,
            (Channel::Topic, false) => Role::Subscription,
            (Channel::Request, false) => Role::Server,
            (Channel::Request, true) => Role::Client,
            (Channel::Response, _) => return None,
        };
        (!seen.is_own).then_some(Self {
            role,
            name: seen.name,
            type_name: seen.type_name,
            qos: seen.qos,
            participant: seen.participant,
        })
    }
}

impl Node {
    /// The GUID prefix of this context's participant.
    pub fn participant(&self) -> [u8; 12] {
        self.inner.backend().participant()
    }

    /// Every endpoint of topics and services of the other participants.
    pub fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        let seen = self.inner.backend().seen();
        seen.into_iter().filter_map(RemoteEndpoint::of).collect()
    }

    /// The full name of the node of a participant, this context's included. Nodes are identified by their parameter
    /// services; `None` if the participant has several nodes, or none with these services.
    pub fn node_of(&self, participant: [u8; 12]) -> Option<String> {
        let nodes = self.nodes_of(participant);
        (nodes.len() == 1)
            .then(|| nodes.into_iter().next())
            .flatten()
    }

    /// The full name of a client's node, as [`node_of`](Self::node_of). `client` is its GUID:
    /// [`Call::client`](crate::Call::client).
    pub fn node_of_client(&self, client: &[u8; 16]) -> Option<String> {
        self.node_of(self.inner.backend().participant_of(client)?)
    }

    /// The full names of a participant's nodes with parameter services.
    pub fn nodes_of(&self, participant: [u8; 12]) -> BTreeSet<String> {
        let seen = self.inner.backend().seen().into_iter();
        let nodes = seen.filter_map(|seen| {
            let is_server = seen.channel == Channel::Request && !seen.is_writer;
            let is_its = is_server && seen.participant == participant;
            let name = is_its.then(|| seen.name.strip_suffix("/get_parameters"));
            name.flatten().map(str::to_owned)
        });
        nodes.collect()
    }

    /// The endpoints of topics.
    fn seen_of_topics(&self) -> impl Iterator<Item = DiscoveredEndpoint> {
        let seen = self.inner.backend().seen().into_iter();
        seen.filter(|seen| seen.channel == Channel::Topic)
    }

    /// Every known topic, this process's own included, by name.
    pub fn topics(&self) -> Vec<TopicInfo> {
        let mut topics: BTreeMap<(String, String), TopicInfo> = BTreeMap::new();
        for seen in self.seen_of_topics() {
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

    /// The number of publishers of a topic.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn count_publishers(&self, topic: &str) -> Result<usize, Error> {
        self.count(topic, true)
    }

    /// The number of subscriptions of a topic.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn count_subscribers(&self, topic: &str) -> Result<usize, Error> {
        self.count(topic, false)
    }

    fn count(&self, topic: &str, is_writer: bool) -> Result<usize, Error> {
        let name = self.resolve(topic)?;
        Ok(self
            .seen_of_topics()
            .filter(|seen| seen.name == name && seen.is_writer == is_writer)
            .count())
    }

    /// Counts changes of the graph: endpoints that appear, disappear or connect. Wait with `changed()`.
    pub fn graph_changes(&self) -> tokio::sync::watch::Receiver<u64> {
        self.inner.backend().changes()
    }
}
