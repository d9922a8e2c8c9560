//! State shared by the endpoints of a participant: endpoints, connections, tasks.

use super::{
    buffer_channels::BufferChannels,
    failure::Failure,
    identity::{Peer, is_foreign},
    mismatches::Mismatches,
    names::ros_names,
    nodes::Nodes,
    own_endpoints::{OwnEndpoint, OwnEndpoints},
    workarounds::{
        catch_up::CatchUp,
        datagram,
        lease::OwnPort,
        line::Lines,
        one_way::OneWay,
        parts::{self, Parts},
        wire::{Wire, usable},
    },
};
use crate::{
    backend::{Channel, EndpointId},
    dds::identity::participant_of,
    local::Local,
    lock::lock,
};
use futures::StreamExt as _;
use rustdds::{
    DomainParticipant, DomainParticipantStatusEvent as Event, EndpointDescription,
    StatusEvented as _, dds::statusevents::LostReason, discovery::DiscoveredReaderData,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex, OnceLock},
    time::Instant,
};
use tokio::{
    runtime::Handle,
    sync::{Notify, watch},
};

/// Participants that are remembered after their lease has run out.
const MOST_SILENT: usize = 1024;

/// Remote endpoints by the own endpoint that they are connected to.
pub(super) type Matches = BTreeMap<EndpointId, BTreeSet<EndpointId>>;

/// See `workarounds/second_participant.rs`.
pub(super) struct SecondParticipant {
    pub(super) participant: DomainParticipant,
    pub(super) publisher: rustdds::Publisher,
}

/// Lives as long as the last endpoint.
pub(super) struct Shared {
    /// `None` once closed.
    pub(super) participant: Mutex<Option<DomainParticipant>>,
    pub(super) publisher: rustdds::Publisher,
    pub(super) subscriber: rustdds::Subscriber,
    /// Runs the receiving tasks.
    pub(super) runtime: Handle,
    pub(super) first: Peer,
    pub(super) second: Mutex<Option<SecondParticipant>>,
    pub(super) second_peer: OnceLock<Peer>,
    pub(super) nodes: Nodes,
    pub(super) local: Local,
    pub(super) lines: Lines,
    pub(super) parts: Parts,
    pub(super) buffer_channels: BufferChannels,
    /// Connections to other participants.
    pub(super) matches: Mutex<Matches>,
    /// Live writers of other participants.
    pub(super) writers: Mutex<BTreeSet<EndpointId>>,
    pub(super) mismatches: Mismatches,
    pub(super) one_way: OneWay,
    /// The way to the first participant, unless it is on loopback.
    pub(super) own_port: OnceLock<Arc<OwnPort>>,
    /// Readers and writers of topics and services.
    pub(super) own: OwnEndpoints,
    /// A participant has returned after its lease ran out.
    pub(super) has_returned: Notify,
    pub(super) catch_up: CatchUp,
    pub(super) wire: Wire,
    pub(super) failure: Arc<Failure>,
    pub(super) is_on_loopback: bool,
    /// Whether this process communicates with no other.
    pub(super) is_alone: bool,
    /// The largest response to a client beyond loopback \[byte\].
    pub(super) largest_answer: usize,
    pub(super) changes: watch::Sender<u64>,
    /// When the last leaving writer may go; see [`super::writer::HAND_OVER`].
    pub(super) staying: Mutex<Option<Instant>>,
}

impl Shared {
    pub(super) fn changed(&self) {
        self.changes.send_modify(|count| *count += 1);
    }

    /// Delays [`crate::backend::Backend::settle`] until then.
    pub(super) fn stay_until(&self, until: Instant) {
        let mut staying = lock(&self.staying);
        *staying = (*staying).max(Some(until));
    }

    /// Remote endpoints that this endpoint is connected to.
    pub(super) fn matched(&self, own: &EndpointId) -> BTreeSet<EndpointId> {
        lock(&self.matches).get(own).cloned().unwrap_or_default()
    }

    /// The largest response that rustdds sends to these clients in one datagram \[byte\].
    pub(super) fn largest_answer(&self, own: &EndpointId, clients: &BTreeSet<EndpointId>) -> usize {
        match self.is_on_loopback && !clients.iter().any(|client| is_foreign(own, client)) {
            true => datagram::LARGEST_ON_LOOPBACK,
            false => self.largest_answer,
        }
    }

    /// The discovered readers; none once the participant is closed.
    pub(super) fn discovered_readers(&self) -> Vec<DiscoveredReaderData> {
        let participant = lock(&self.participant);
        participant
            .as_ref()
            .map_or_else(Vec::new, DomainParticipant::discovered_readers)
    }

    /// The addresses of these readers.
    pub(super) fn addresses_of(
        &self,
        readers: &BTreeSet<EndpointId>,
    ) -> Vec<(EndpointId, Vec<SocketAddr>)> {
        // without the list, all addresses of a reader on this host are used
        let interfaces = if_addrs::get_if_addrs().unwrap_or_default();
        let own: Vec<IpAddr> = interfaces.iter().map(if_addrs::Interface::ip).collect();
        let discovered = self.discovered_readers().into_iter();
        discovered
            .map(|reader| reader.reader_proxy)
            .map(|proxy| (proxy.remote_reader_guid.to_bytes(), proxy))
            .filter(|(id, _)| readers.contains(id))
            .map(|(id, proxy)| {
                let announced = proxy.unicast_locator_list.into_iter();
                let announced = announced.map(SocketAddr::from);
                (id, usable(announced, &own, self.is_on_loopback))
            })
            .collect()
    }

    /// The endpoints of this process.
    pub(super) fn own_endpoints(&self) -> BTreeMap<EndpointId, OwnEndpoint> {
        let mut own = self.own.all();
        for (id, topic) in self.parts.writers() {
            own.insert(id, parts::endpoint(topic, true));
        }
        own
    }

    /// A remote endpoint has gone.
    pub(super) fn forget_other(&self, id: &EndpointId) {
        self.mismatches.forget_other(id);
        self.parts.forget_other(id);
        lock(&self.writers).remove(id);
        lock(&self.matches).retain(|_, others| {
            others.remove(id);
            !others.is_empty()
        });
    }

    /// A remote participant has gone without disposing its endpoints one by one.
    fn forget_participant(&self, peer: &Peer) {
        let is_of = |id: &EndpointId| participant_of(id) == *peer;
        let mut gone: BTreeSet<EndpointId> = lock(&self.writers).iter().copied().collect();
        gone.extend(lock(&self.matches).values().flatten());
        gone.retain(is_of);
        gone.iter().for_each(|id| self.forget_other(id));
        self.parts.forget_participant(peer);
    }

    /// Records own endpoints of another type on the topic of a remote endpoint.
    pub(super) fn compare_types(&self, other: &EndpointDescription, is_writer: bool) {
        let Some((Channel::Topic, topic, type_name)) =
            ros_names(&other.topic_name, &other.type_name)
        else {
            return;
        };
        let id = other.guid.to_bytes();
        for (own, own_type) in self.nodes.of_other_type(&topic, &type_name, is_writer) {
            let own = self.lines.publisher_of(&own);
            let types = (own_type.as_str(), type_name.as_str());
            self.mismatches.types(own, id, &topic, types, is_writer);
        }
    }

    /// Whether the endpoint belongs to the first or second participant of this process.
    pub(super) fn is_own(&self, id: &EndpointId) -> bool {
        let peer = participant_of(id);
        peer == self.first || self.second_peer.get() == Some(&peer)
    }

    /// Whether this remote writer still exists.
    pub(super) fn is_there(&self, writer: &EndpointId) -> bool {
        lock(&self.writers).contains(writer)
    }

    /// Whether the readers of one DDS writer are connected to its successor too.
    pub(super) fn has_readers_of(&self, next: &EndpointId, line: &EndpointId) -> bool {
        let matches = lock(&self.matches);
        match (matches.get(line), matches.get(next)) {
            (None, _) => true,
            (Some(_), None) => false,
            (Some(readers), Some(connected)) => readers.is_subset(connected),
        }
    }

    /// A DDS writer of a publisher has gone.
    pub(super) fn forget_line(&self, line: &EndpointId) {
        self.lines.remove(line);
        self.one_way.forget_line(line);
        self.parts.forget_own(line);
        lock(&self.matches).remove(line);
        self.nodes.remove_endpoint(line);
        self.own.remove(line);
        self.changed();
    }

    /// Removes an own endpoint from every list.
    pub(super) fn forget(&self, id: &EndpointId) {
        self.local.remove(id);
        self.parts.forget_own(id);
        lock(&self.matches).remove(id);
        self.mismatches.forget_own(id);
        self.nodes.remove_endpoint(id);
        self.own.remove(id);
        self.changed();
    }
}

/// Updates the connections from the participant's events.
pub(super) async fn follow(
    listener: rustdds::DomainParticipantStatusListener,
    shared: Arc<Shared>,
    own_port: Option<Arc<OwnPort>>,
) {
    let mut events = listener.as_async_status_stream();
    // participants that may return after their lease ran out
    let mut silent = BTreeSet::new();
    while let Some(event) = events.next().await {
        match event {
            Event::RemoteReaderMatched {
                local_writer: own,
                remote_reader: other,
            }
            | Event::RemoteWriterMatched {
                local_reader: own,
                remote_writer: other,
            } => {
                let (own, other) = (own.to_bytes(), other.to_bytes());
                if shared.is_own(&other) {
                    continue;
                }
                lock(&shared.matches).entry(own).or_default().insert(other);
            }
            Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
                shared.forget_other(&guid.to_bytes());
            }
            Event::ParticipantDiscovered { dpd } => {
                let id = dpd.guid.to_bytes();
                shared.catch_up.discovered(&id, Instant::now());
                if silent.remove(&participant_of(&id)) {
                    shared.has_returned.notify_one();
                }
                continue;
            }
            // if a lease runs out, there are no events for the single endpoints
            Event::ParticipantLost { id, reason } => {
                let prefix = id.as_ref().get(..size_of::<Peer>());
                if let Some(peer) = prefix.and_then(|prefix| Peer::try_from(prefix).ok()) {
                    shared.forget_participant(&peer);
                    shared.one_way.lost(&peer);
                    if matches!(reason, LostReason::Timeout { .. }) {
                        if silent.len() >= MOST_SILENT {
                            silent.pop_first();
                        }
                        silent.insert(peer);
                        if let Some(own_port) = &own_port {
                            own_port.forget_announcements();
                        }
                    }
                }
            }
            Event::RemoteReaderQosIncompatible {
                local_writer,
                remote_reader,
                requested_qos,
                offered_qos,
            } => {
                let (own, other) = (local_writer.to_bytes(), remote_reader.to_bytes());
                let topic = shared.nodes.topic_of(&own);
                let own = shared.lines.publisher_of(&own);
                let qos = (&*requested_qos, &*offered_qos);
                shared.mismatches.policies(own, other, topic, false, qos);
            }
            Event::RemoteWriterQosIncompatible {
                local_reader,
                remote_writer,
                requested_qos,
                offered_qos,
            } => {
                let (own, other) = (local_reader.to_bytes(), remote_writer.to_bytes());
                let topic = shared.nodes.topic_of(&own);
                let qos = (&*requested_qos, &*offered_qos);
                shared.mismatches.policies(own, other, topic, true, qos);
            }
            // rustdds reports own endpoints too
            Event::WriterDetected { writer: other } | Event::ReaderDetected { reader: other }
                if shared.is_own(&other.guid.to_bytes()) => {}
            Event::WriterDetected { writer } => {
                lock(&shared.writers).insert(writer.guid.to_bytes());
                shared.buffer_channels.detect(&writer.topic_name);
                shared.compare_types(&writer, true);
            }
            Event::ReaderDetected { reader } => {
                shared.parts.add_peer(reader.guid, &reader.topic_name);
                shared.compare_types(&reader, false);
            }
            _ => continue,
        }
        shared.changed();
    }
}
