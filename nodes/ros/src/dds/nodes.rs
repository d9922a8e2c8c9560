//! Announces on `ros_discovery_info` which endpoint belongs to which node, for `ros2 node list` and `ros2 node info`.

use super::{
    codec::Raw,
    names::{dds_name, dds_type, ros_names},
    own_endpoints::OwnEndpoint,
};
use crate::{
    Error,
    backend::{Channel, DiscoveredEndpoint, Endpoint, EndpointId},
    dds::identity::participant_of,
    lock::lock,
};
use bytes::Bytes;
use ros2_client::{
    Gid, NodeName,
    builtin_topics::ros_discovery,
    entities_info::{NodeEntitiesInfo, ParticipantEntitiesInfo},
};
use rustdds::{DomainParticipant, QosPolicyBuilder, RTPSEntity as _, Timestamp, TopicKind, policy};
use std::{collections::BTreeMap, sync::Mutex};

struct NodeEndpoint {
    /// The full name.
    node: String,
    seen: Option<DiscoveredEndpoint>,
    is_writer: bool,
}

#[derive(Default)]
struct Table {
    nodes: BTreeMap<String, NodeName>,
    endpoints: BTreeMap<EndpointId, NodeEndpoint>,
}

pub(super) struct Nodes {
    participant: Gid,
    table: Mutex<Table>,
    /// `None` once the participant has left.
    writer: Mutex<Option<rustdds::no_key::DataWriter<Bytes, Raw>>>,
}

impl Nodes {
    pub(super) fn new(
        participant: &DomainParticipant,
        publisher: &rustdds::Publisher,
    ) -> Result<Self, Error> {
        let failed = |error| Error::middleware("announce nodes", error);
        let (name, type_name) = (
            ros_discovery::TOPIC_NAME.to_owned(),
            ros_discovery::TYPE_NAME.to_owned(),
        );
        let qos = &ros_discovery::QOS_PUB;
        let topic = participant
            .create_topic(name, type_name, qos, TopicKind::NoKey)
            .map_err(failed)?;
        // each new reader would stop a bounded writer for a moment
        let unbounded = policy::ResourceLimits {
            max_samples: i32::MAX,
            max_instances: i32::MAX,
            max_samples_per_instance: i32::MAX,
        };
        let unbounded = QosPolicyBuilder::new().resource_limits(unbounded).build();
        let writer = publisher
            .create_datawriter_no_key(&topic, Some(unbounded))
            .map_err(failed)?;
        Ok(Self {
            participant: Gid::from(participant.guid()),
            table: Mutex::default(),
            writer: Mutex::new(Some(writer)),
        })
    }

    pub(super) fn add(&self, namespace: &str, base: &str) -> Result<(), Error> {
        let name = NodeName::new(namespace, base).map_err(|reason| Error::Name {
            name: format!("{namespace}/{base}"),
            kind: "node",
            reason: reason.to_string(),
        })?;
        lock(&self.table)
            .nodes
            .insert(name.fully_qualified_name(), name);
        self.announce();
        Ok(())
    }

    pub(super) fn remove(&self, namespace: &str, base: &str) {
        if let Ok(name) = NodeName::new(namespace, base) {
            lock(&self.table).nodes.remove(&name.fully_qualified_name());
            self.announce();
        }
    }

    pub(super) fn add_endpoint(
        &self,
        id: EndpointId,
        node: &str,
        endpoint: &Endpoint,
        is_writer: bool,
    ) {
        let seen = ros_names(&dds_name(endpoint), &dds_type(endpoint)).map(
            |(channel, name, type_name)| DiscoveredEndpoint {
                channel,
                name,
                type_name,
                qos: endpoint.qos,
                is_writer,
                id,
                participant: participant_of(&id),
                is_own: true,
                type_hash: None,
            },
        );
        lock(&self.table).endpoints.insert(
            id,
            NodeEndpoint {
                node: node.to_owned(),
                seen,
                is_writer,
            },
        );
        self.announce();
    }

    pub(super) fn remove_endpoint(&self, id: &EndpointId) {
        lock(&self.table).endpoints.remove(id);
        self.announce();
    }

    pub(super) fn own_endpoints(&self) -> Vec<DiscoveredEndpoint> {
        lock(&self.table)
            .endpoints
            .values()
            .filter_map(|own| own.seen.clone())
            .collect()
    }

    /// The topic of an endpoint of this process.
    pub(super) fn topic_of(&self, id: &EndpointId) -> Option<String> {
        lock(&self.table)
            .endpoints
            .get(id)?
            .seen
            .as_ref()
            .map(|seen| seen.name.clone())
    }

    /// The own endpoints on this topic that would connect to a remote endpoint if their type, also returned, were the
    /// same.
    pub(super) fn of_other_type(
        &self,
        topic: &str,
        type_name: &str,
        is_writer: bool,
    ) -> Vec<(EndpointId, String)> {
        let table = lock(&self.table);
        let seen = table.endpoints.values().filter_map(|own| own.seen.as_ref());
        seen.filter(|seen| {
            seen.channel == Channel::Topic
                && seen.is_writer != is_writer
                && seen.name == topic
                && seen.type_name != type_name
        })
        .map(|seen| (seen.id, seen.type_name.clone()))
        .collect()
    }

    /// Whether this process has a reader on the topic of `endpoint`.
    pub(super) fn reads(&self, endpoint: &Endpoint) -> bool {
        let table = lock(&self.table);
        let mut seen = table.endpoints.values().filter_map(|own| own.seen.as_ref());
        seen.any(|seen| {
            !seen.is_writer && seen.channel == endpoint.channel && seen.name == endpoint.name
        })
    }

    /// Announces an empty list of nodes, and nothing after it.
    pub(super) fn leave(&self) {
        lock(&self.table).nodes.clear();
        self.announce();
        lock(&self.writer).take();
    }

    /// The writer of these announcements.
    pub(super) fn endpoint(&self) -> Option<(EndpointId, OwnEndpoint)> {
        let id = lock(&self.writer).as_ref()?.guid().to_bytes();
        let own = OwnEndpoint {
            topic: ros_discovery::TOPIC_NAME.to_owned(),
            type_name: ros_discovery::TYPE_NAME.to_owned(),
            qos: ros_discovery::QOS_PUB.clone(),
            is_writer: true,
        };
        Some((id, own))
    }

    /// Announces the current nodes.
    pub(super) fn announce(&self) {
        // held throughout, so that announcements keep the order of the changes
        let writer = lock(&self.writer);
        let Some(writer) = writer.as_ref() else {
            return;
        };
        let table = lock(&self.table);
        let describe = |(full_name, name): (&String, &NodeName)| {
            let mut info = NodeEntitiesInfo::new(name.clone());
            for (id, own) in table
                .endpoints
                .iter()
                .filter(|(_, own)| own.node == *full_name)
            {
                match own.is_writer {
                    true => info.add_writer(Gid::from(*id)),
                    false => info.add_reader(Gid::from(*id)),
                }
            }
            info
        };
        let info = ParticipantEntitiesInfo::new(
            self.participant,
            table.nodes.iter().map(describe).collect(),
        );
        drop(table);
        let sent = match wm_msgs::cdr::to_bytes(&info) {
            Ok(bytes) => writer
                .write(Bytes::from(bytes), Some(Timestamp::now()))
                .map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        if let Err(error) = sent {
            // the next change announces the whole table again
            tracing::debug!("cannot announce the nodes: {error}");
        }
    }
}
