//! The DDS middleware: rustdds for the wire, ros2-client for what ROS 2 adds to it (names, and the announcement of
//! which node an endpoint belongs to).
//!
//! What is minded here, each at its place:
//! - a reliable writer's window is bounded ([`qos::RELIABLE_WINDOW`]), since KeepLast alone would let a stopped
//!   reader hold 8192 samples in memory;
//! - ros2-client's own node and spinner are not used: its `/clock` has the wrong type, its parameters no
//!   descriptors, and its spinner keeps the participant alive;
//! - large messages go in parts ([`parts`]), since their bursts overflow the receive buffers of Linux;
//! - a participant's writers and readers are connected here, since rustdds does not do it on loopback;
//! - the participant goes last, after its readers and writers, or the others never hear that it left.

mod answers;
mod codec;
mod datagram;
mod endpoint;
mod local;
mod lock;
mod mismatches;
mod names;
mod nodes;
mod parts;
mod qos;
mod second;
mod shared;

use crate::{
    Environment, Error, Qos,
    backend::{Backend, Channel, Endpoint, EndpointId, Reader, Seen, Sink, Writer},
};
pub(crate) use parts::decode_part;

use endpoint::{DdsReader, DdsWriter};
use local::Local;
use lock::lock;
use mismatches::Mismatches;
use names::{dds_name, dds_type, ros_names};
use nodes::Nodes;
use parts::{Parts, peer_of};
use rustdds::{DomainParticipant, RTPSEntity as _};
use shared::{Shared, follow, is_foreign};
use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex, OnceLock},
};
use tokio::{runtime::Handle, sync::watch};

/// A participant of a DDS domain.
pub(crate) struct Dds {
    id: EndpointId,
    subscriber: rustdds::Subscriber,
    shared: Arc<Shared>,
    environment: Environment,
    runtime: Handle,
}

impl Dds {
    /// Joins the domain. `runtime` runs what receives; it must be stopped before [`Backend::close`].
    pub(crate) fn join(environment: &Environment, runtime: Handle) -> Result<Arc<Self>, Error> {
        let failed =
            |error| Error::middleware(format!("join DDS domain {}", environment.domain_id), error);
        let participant = second::participant(environment)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&defaults).map_err(failed)?;
        let subscriber = participant.create_subscriber(&defaults).map_err(failed)?;
        let (id, events) = (participant.guid().to_bytes(), participant.status_listener());
        let shared = Arc::new(Shared {
            nodes: Nodes::announce(&participant, &publisher)?,
            participant: Mutex::new(Some(participant)),
            publisher,
            first: peer_of(&id),
            second: Mutex::default(),
            second_peer: OnceLock::new(),
            local: Local::default(),
            parts: Parts::default(),
            matches: Mutex::default(),
            writers: Mutex::default(),
            mismatches: Mismatches::default(),
            is_on_loopback: environment.is_on_loopback(),
            is_alone: environment.is_alone(),
            largest_answer: datagram::largest_answer(),
            changes: watch::Sender::new(0),
        });
        // the first endpoint of all: who knows a topic's readers knows how they take large messages
        let parts = shared.parts_reader(&subscriber, &id)?;
        runtime.spawn(follow(events, Arc::clone(&shared)));
        runtime.spawn(parts::exchange(parts, Arc::clone(&shared)));
        Ok(Arc::new(Self {
            id,
            subscriber,
            shared,
            environment: environment.clone(),
            runtime,
        }))
    }

    fn topic(
        &self,
        endpoint: &Endpoint,
        qos: &rustdds::QosPolicies,
    ) -> Result<rustdds::Topic, Error> {
        let participant = lock(&self.shared.participant);
        let Some(participant) = participant.as_ref() else {
            return Err(Error::ShutDown(endpoint.name.clone()));
        };
        topic(participant, endpoint, qos)
    }
}

impl Dds {
    /// Notes which endpoints elsewhere, known already, are of another type than this new one; for those that come
    /// later, see [`Shared::compare_types`].
    fn compare_types(&self, own: EndpointId, endpoint: &Endpoint, is_writer: bool) {
        if endpoint.channel != Channel::Topic {
            return;
        }
        let (package, name) = (&endpoint.type_name.package, &endpoint.type_name.name);
        let own_type = format!("{package}/msg/{name}");
        let others = self.seen().into_iter().filter(|seen| {
            !seen.is_own
                && seen.channel == endpoint.channel
                && seen.is_writer != is_writer
                && seen.name == endpoint.name
                && seen.type_name != own_type
        });
        for other in others {
            let types = (own_type.as_str(), other.type_name.as_str());
            let mismatches = &self.shared.mismatches;
            mismatches.types(own, other.id, &other.name, types, other.is_writer);
        }
    }
}

fn topic(
    participant: &DomainParticipant,
    endpoint: &Endpoint,
    qos: &rustdds::QosPolicies,
) -> Result<rustdds::Topic, Error> {
    let (name, type_name) = (dds_name(endpoint), dds_type(endpoint));
    participant
        .create_topic(name, type_name, qos, rustdds::TopicKind::NoKey)
        .map_err(|error| Error::middleware(format!("create the topic {}", endpoint.name), error))
}

impl Backend for Dds {
    fn participant(&self) -> EndpointId {
        self.id
    }

    fn add_node(&self, namespace: &str, base: &str) -> Result<(), Error> {
        self.shared.nodes.add(namespace, base)
    }

    fn remove_node(&self, namespace: &str, base: &str) {
        self.shared.nodes.remove(namespace, base);
    }

    fn writer(&self, node: &str, endpoint: &Endpoint) -> Result<Box<dyn Writer>, Error> {
        let qos = qos::for_writer(endpoint.qos);
        let failed = |error| Error::middleware(format!("publish {}", endpoint.name), error);
        let writer = if self.goes_apart(endpoint) {
            self.writer_apart(endpoint, qos)?
        } else {
            let topic = self.topic(endpoint, &qos)?;
            let publisher = &self.shared.publisher;
            publisher.create_datawriter_no_key(&topic, Some(qos))
        };
        let (writer, shared) = (writer.map_err(failed)?, &self.shared);
        let writer = DdsWriter::new(writer, endpoint, node, shared, &self.runtime);
        self.compare_types(writer.id(), endpoint, true);
        Ok(Box::new(writer))
    }

    fn reader(
        &self,
        node: &str,
        endpoint: &Endpoint,
        sink: Sink,
    ) -> Result<Box<dyn Reader>, Error> {
        let qos = qos::for_reader(endpoint.qos);
        let topic = self.topic(endpoint, &qos)?;
        let began = rustdds::Timestamp::now();
        let reader = self
            .subscriber
            .create_simple_datareader_no_key(&topic, Some(qos))
            .map_err(|error| Error::middleware(format!("subscribe to {}", endpoint.name), error))?;
        let (shared, runtime) = (&self.shared, &self.runtime);
        let reader = DdsReader::new(reader, began, endpoint, node, shared, sink, runtime);
        self.compare_types(reader.id(), endpoint, false);
        Ok(Box::new(reader))
    }

    fn seen(&self) -> Vec<Seen> {
        let mut seen = self.shared.nodes.own_endpoints();
        let participant = lock(&self.shared.participant);
        let Some(participant) = participant.as_ref() else {
            return seen;
        };
        let mut see = |guid: rustdds::GUID, name: &str, dds_type: &str, qos, is_writer| {
            let id = guid.to_bytes();
            // Where multicast reflects them, a participant discovers its own endpoints too.
            if self.shared.is_own(&id) {
                return;
            }
            if let Some((channel, name, type_name)) = ros_names(name, dds_type) {
                seen.push(Seen {
                    channel,
                    name,
                    type_name,
                    qos,
                    is_writer,
                    id,
                    is_own: false,
                });
            }
        };
        for writer in participant.discovered_writers() {
            let (guid, topic) = (
                writer.writer_proxy.remote_writer_guid,
                &writer.publication_topic_data,
            );
            let qos = qos::from_dds(&topic.qos());
            see(guid, &topic.topic_name, &topic.type_name, qos, true);
        }
        for reader in participant.discovered_readers() {
            let (guid, topic) = (
                reader.reader_proxy.remote_reader_guid,
                &reader.subscription_topic_data,
            );
            let qos = qos::from_dds(&topic.qos());
            see(guid, topic.topic_name(), topic.type_name(), qos, false);
        }
        seen
    }

    fn matched(&self, endpoint: &EndpointId) -> usize {
        let elsewhere = lock(&self.shared.matches)
            .get(endpoint)
            .map_or(0, BTreeSet::len);
        elsewhere + self.shared.local.matched(endpoint)
    }

    fn foreign(&self, endpoint: &EndpointId) -> usize {
        let matches = lock(&self.shared.matches);
        let others = matches.get(endpoint).into_iter().flatten();
        others.filter(|other| is_foreign(endpoint, other)).count()
    }

    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String> {
        self.shared.mismatches.of(endpoint)
    }

    fn changes(&self) -> watch::Receiver<u64> {
        self.shared.changes.subscribe()
    }

    fn is_alive(&self) -> bool {
        // The thread that does discovery takes the command, or is gone: rustdds 0.15.1 ends its threads where the
        // system interrupts their waiting, as it does when a process is stopped and continued.
        let participant = lock(&self.shared.participant);
        let asserted = participant
            .as_ref()
            .map(DomainParticipant::assert_liveliness);
        asserted.is_none_or(|asserted| asserted.is_ok())
    }

    fn close(&self) {
        self.shared.nodes.leave();
        self.shared.parts.leave();
        drop(lock(&self.shared.second).take());
        let participant = lock(&self.shared.participant).take();
        drop(participant);
    }
}

impl From<Qos> for rustdds::policy::Reliability {
    fn from(qos: Qos) -> Self {
        match qos.reliability {
            crate::Reliability::BestEffort => Self::BestEffort,
            // zero: a full window is reported at once instead of blocking the node
            crate::Reliability::Reliable => Self::Reliable {
                max_blocking_time: rustdds::Duration::ZERO,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{names::tests::endpoint, *};

    #[tokio::test(flavor = "multi_thread")]
    async fn an_answer_waits_until_its_client_can_hear_it() {
        const PATIENCE: std::time::Duration = std::time::Duration::from_secs(20);
        let environment = Environment {
            domain_id: 100 + (std::process::id() % 20) as u16,
            reach: crate::Reach::Localhost,
        };
        let join = || Dds::join(&environment, Handle::current()).unwrap();
        let (server, client) = (join(), join());
        let (calls, mut called) = tokio::sync::mpsc::unbounded_channel();
        let sink = move |sample: Result<crate::backend::Sample, String>| {
            calls.send(sample.unwrap().request.unwrap()).unwrap();
        };
        let _requests = server
            .reader("/server", &endpoint(Channel::Request), Box::new(sink))
            .unwrap();
        let answers = server
            .writer("/server", &endpoint(Channel::Response))
            .unwrap();
        let requests = client
            .writer("/client", &endpoint(Channel::Request))
            .unwrap();
        let sample = bytes::Bytes::from_static(&[0, 1, 0, 0, 7, 0, 0, 0]);

        let mut changes = client.changes();
        while client.matched(&requests.id()) == 0 {
            tokio::time::timeout(PATIENCE, changes.changed())
                .await
                .unwrap()
                .unwrap();
        }
        requests.write(&sample, None).unwrap();
        let request = tokio::time::timeout(PATIENCE, called.recv())
            .await
            .unwrap()
            .unwrap();
        // The client has no reader yet: an answer sent now would reach nobody.
        let written = answers.write(&sample, Some(request)).unwrap();
        assert_eq!(written, crate::backend::Written::Held);

        let (heard, mut hears) = tokio::sync::mpsc::unbounded_channel();
        let sink = move |sample: Result<crate::backend::Sample, String>| {
            heard.send(sample.unwrap().bytes).unwrap();
        };
        let _answers = client
            .reader("/client", &endpoint(Channel::Response), Box::new(sink))
            .unwrap();
        let answer = tokio::time::timeout(PATIENCE, hears.recv())
            .await
            .unwrap()
            .unwrap();
        assert_eq!(answer, sample);
    }
}
