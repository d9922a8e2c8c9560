//! DDS as the middleware: rustdds for the wire, ros2-client for names and for the announcement of nodes.
//!
//! [`workarounds`] lists the faults of rustdds and their cures. ros2-client's own node and spinner are not used: its
//! `/clock` has the wrong type, its parameters have no descriptors, and its spinner keeps the participant alive.
//!
//! The participant is dropped after its readers and writers; otherwise other participants do not receive its departure.

mod answers;
mod buffer_channels;
mod channel_reader;
mod codec;
mod failure;
mod identity;
mod mismatches;
mod names;
mod nodes;
mod own_endpoints;
mod participant;
mod qos;
mod reader;
mod received;
mod shared;
#[cfg(test)]
mod tests;
mod type_hash;
mod workarounds;
mod writer;

use crate::{
    Environment, Error,
    backend::{
        Backend, Channel, DiscoveredEndpoint, Endpoint, EndpointId, ParticipantId, Reader, Sink,
        Writer,
    },
    local::Local,
    lock::lock,
};
pub(crate) use workarounds::parts::decode_part;

use buffer_channels::BufferChannels;
use futures::FutureExt as _;
use identity::{Peer, is_foreign, participant_of};
use mismatches::Mismatches;
use names::{dds_name, dds_type, ros_names};
use nodes::Nodes;
use own_endpoints::{OwnEndpoint, OwnEndpoints};
use reader::DdsReader;
use rustdds::{DomainParticipant, RTPSEntity as _};
use shared::Shared;
use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex, OnceLock},
    time::Instant,
};
use tokio::{
    runtime::Handle,
    sync::{Notify, watch},
};
use workarounds::{
    addresses::Addresses,
    catch_up::CatchUp,
    datagram,
    line::{Lines, Maker},
    one_way::OneWay,
    parts::{self, Parts},
    reconcile::Reconciler,
    wire,
};
use writer::DdsWriter;

/// A participant of a DDS domain.
pub(crate) struct Dds {
    shared: Arc<Shared>,
    environment: Environment,
    addresses: Addresses,
    runtime: Handle,
}

impl Dds {
    /// Joins the domain. `runtime` runs the receiving tasks; stop it before [`Backend::close`].
    pub(crate) fn join(environment: &Environment, runtime: Handle) -> Result<Arc<Self>, Error> {
        let failed =
            |error| Error::middleware(format!("join DDS domain {}", environment.domain_id), error);
        let wire = wire::Wire::open().map_err(|source| Error::io("open a UDP socket", source))?;
        let addresses = Addresses::of(environment)?;
        let participant = participant::join(environment)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&defaults).map_err(failed)?;
        let subscriber = participant.create_subscriber(&defaults).map_err(failed)?;
        let id = participant.guid().to_bytes();
        let shared = Arc::new(Shared {
            nodes: Nodes::new(&participant, &publisher)?,
            participant: Mutex::new(Some(participant)),
            publisher,
            subscriber,
            runtime: runtime.clone(),
            first: participant_of(&id),
            second: Mutex::default(),
            second_peer: OnceLock::new(),
            local: Local::default(),
            lines: Lines::default(),
            parts: Parts::default(),
            buffer_channels: BufferChannels::default(),
            matches: Mutex::default(),
            writers: Mutex::default(),
            mismatches: Mismatches::default(),
            one_way: OneWay::default(),
            own_port: OnceLock::new(),
            own: OwnEndpoints::default(),
            has_returned: Notify::default(),
            catch_up: CatchUp::default(),
            wire,
            failure: Arc::default(),
            is_on_loopback: environment.is_on_loopback(),
            is_alone: environment.is_alone(),
            largest_answer: datagram::largest_answer(),
            changes: watch::Sender::new(0),
            staying: Mutex::default(),
        });
        // the first endpoint: a participant that discovers a topic's readers then knows whether they take parts
        let parts = shared.parts_reader(&id)?;
        let reader = parts::endpoint(parts::topic_of(&shared.first), false);
        shared.own.add(parts.guid().to_bytes(), reader);
        if let Some((id, own)) = shared.nodes.endpoint() {
            shared.own.add(id, own);
        }
        let spawn = |task, future| drop(shared.failure.watch(&runtime, task, future));
        let exchange = parts::exchange::exchange(parts, Arc::clone(&shared));
        spawn("large messages", exchange.boxed());
        if !environment.is_alone() {
            let reconciled = Reconciler::new(Arc::clone(&shared)).run();
            spawn("reconciliation", reconciled.boxed());
        }
        let this = Self {
            shared,
            environment: environment.clone(),
            addresses,
            runtime,
        };
        if let Some(participant) = lock(&this.shared.participant).as_ref() {
            this.start_tasks(participant)?;
        }
        Ok(Arc::new(this))
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
        participant::topic(participant, endpoint, qos)
    }

    /// Records the discovered endpoints with another type than this new one. [`Shared::compare_types`] covers later
    /// ones.
    fn compare_types(&self, own: EndpointId, endpoint: &Endpoint, is_writer: bool) {
        if endpoint.channel != Channel::Topic {
            return;
        }
        let own_type = endpoint.type_name.to_string();
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

impl Backend for Dds {
    fn participant(&self) -> ParticipantId {
        self.shared.first
    }

    fn participant_of(&self, endpoint: &EndpointId) -> Option<ParticipantId> {
        Some(participant_of(endpoint))
    }

    fn excludes_by_qos(&self) -> bool {
        true
    }

    fn add_node(&self, namespace: &str, base: &str) -> Result<(), Error> {
        self.shared.nodes.add(namespace, base)
    }

    fn remove_node(&self, namespace: &str, base: &str) {
        self.shared.nodes.remove(namespace, base);
    }

    fn writer(&self, node: &str, endpoint: &Endpoint) -> Result<Box<dyn Writer>, Error> {
        self.shared.catch_up.wait();
        let qos = qos::for_writer(endpoint.qos);
        let failed = |error| Error::middleware(format!("publish {}", endpoint.name), error);
        let maker = if self.needs_second_participant(endpoint) {
            self.second_maker(endpoint, qos)?
        } else {
            let topic = self.topic(endpoint, &qos::for_reader(endpoint.qos))?;
            let publisher = self.shared.publisher.clone();
            Maker {
                publisher,
                topic,
                qos,
            }
        };
        let writer = DdsWriter::new(maker, endpoint, node, &self.shared, &self.runtime);
        let writer = writer.map_err(failed)?;
        self.compare_types(writer.id(), endpoint, true);
        Ok(Box::new(writer))
    }

    fn reader(
        &self,
        node: &str,
        endpoint: &Endpoint,
        sink: Sink,
    ) -> Result<Box<dyn Reader>, Error> {
        self.shared.catch_up.wait();
        let qos = qos::for_reader(endpoint.qos);
        let topic = self.topic(endpoint, &qos)?;
        let began = rustdds::Timestamp::now();
        let reader = self
            .shared
            .subscriber
            .create_simple_datareader_no_key(&topic, Some(qos.clone()))
            .map_err(|error| Error::middleware(format!("subscribe to {}", endpoint.name), error))?;
        let shared = &self.shared;
        if endpoint.has_siblings {
            shared.mismatches.tolerate(reader.guid().to_bytes());
        }
        let own = OwnEndpoint {
            topic: dds_name(endpoint),
            type_name: dds_type(endpoint),
            qos,
            is_writer: false,
        };
        let reader = DdsReader::new(reader, began, endpoint, own, node, shared, sink);
        self.compare_types(reader.id(), endpoint, false);
        Ok(Box::new(reader))
    }

    fn seen(&self) -> Vec<DiscoveredEndpoint> {
        let mut seen = self.shared.nodes.own_endpoints();
        let participant = lock(&self.shared.participant);
        let Some(participant) = participant.as_ref() else {
            return seen;
        };
        // `user_data`: of a writer.
        let mut add =
            |guid: rustdds::GUID, name: &str, dds_type: &str, qos, user_data: Option<&[u8]>| {
                let id = guid.to_bytes();
                // If multicast reflects its announcements, a participant discovers its own endpoints.
                if self.shared.is_own(&id) {
                    return;
                }
                if let Some((channel, name, type_name)) = ros_names(name, dds_type) {
                    seen.push(DiscoveredEndpoint {
                        channel,
                        name,
                        type_name,
                        qos,
                        is_writer: user_data.is_some(),
                        id,
                        participant: participant_of(&id),
                        is_own: false,
                        type_hash: user_data.and_then(type_hash::announced),
                    });
                }
            };
        for writer in participant.discovered_writers() {
            let (guid, topic) = (
                writer.writer_proxy.remote_writer_guid,
                &writer.publication_topic_data,
            );
            let qos = qos::from_dds(&topic.qos());
            let user_data = Some(&writer.user_data[..]);
            add(guid, &topic.topic_name, &topic.type_name, qos, user_data);
        }
        for reader in participant.discovered_readers() {
            let (guid, topic) = (
                reader.reader_proxy.remote_reader_guid,
                &reader.subscription_topic_data,
            );
            let qos = qos::from_dds(&topic.qos());
            add(guid, topic.topic_name(), topic.type_name(), qos, None);
        }
        seen
    }

    fn matched(&self, endpoint: &EndpointId) -> usize {
        let line = self.shared.lines.current(endpoint);
        self.shared.matched(&line).len() + self.shared.local.matched(endpoint)
    }

    /// The two ends of a server that has just left or arrived are not connected at the same time.
    fn has_server(&self, requests: &EndpointId, responses: &EndpointId) -> bool {
        let participants = |own: &EndpointId| -> BTreeSet<Peer> {
            let others = self.shared.matched(&self.shared.lines.current(own));
            others.iter().map(participant_of).collect()
        };
        let is_here = || self.shared.local.matched(requests) > 0;
        !participants(requests).is_disjoint(&participants(responses)) || is_here()
    }

    fn foreign(&self, endpoint: &EndpointId) -> usize {
        let others = self.shared.matched(&self.shared.lines.current(endpoint));
        let others = others.iter();
        others.filter(|other| is_foreign(endpoint, other)).count()
    }

    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String> {
        self.shared.mismatches.of(endpoint)
    }

    fn changes(&self) -> watch::Receiver<u64> {
        self.shared.changes.subscribe()
    }

    fn failure(&self) -> Option<Error> {
        // readers in this process do not depend on the wall clock
        if let Some(failure) = self.shared.failure.check(!self.shared.is_alone) {
            return Some(failure);
        }
        if let Some(change) = self.addresses.check() {
            return Some(change);
        }
        // The discovery thread accepts the command unless it has ended: rustdds 0.15.1 ends its threads if a signal
        // interrupts their wait, for example when a process is stopped and continued.
        let participant = lock(&self.shared.participant);
        let asserted = participant
            .as_ref()
            .map(DomainParticipant::assert_liveliness);
        let has_ended = asserted.is_some_and(|asserted| asserted.is_err());
        has_ended.then_some(Error::MiddlewareEnded)
    }

    fn settle(&self) {
        let staying = lock(&self.shared.staying).take();
        if let Some(until) = staying {
            std::thread::sleep(until.saturating_duration_since(Instant::now()));
        }
    }

    fn close(&self) {
        self.shared.nodes.leave();
        self.shared.parts.leave();
        drop(lock(&self.shared.second).take());
        let participant = lock(&self.shared.participant).take();
        drop(participant);
    }
}
