//! Large messages between participants of this suite, whatever the receive buffer of the machine.
//!
//! rustdds sends a sample as one burst of fragments. One of 512 KiB overflows Linux's default receive buffer of
//! 208 KiB, and reliable readers fare no better, since its repairs are bursts as well. So a volatile writer of a topic
//! goes over to parts with its first large message: it offers each message to the participants that read the topic and
//! have a reader of parts, keeps as many as its history is deep, and sends the parts that they ask for. Each asks for
//! a few at a time, so that nothing overflows, asks again for what does not come, and answers when it has a message.
//! A reader that stops asks for nothing and holds up nobody: it loses the oldest messages once too many wait for it, and
//! all but the newest once it has been silent for seconds. A part is sent only to a reader that it was offered to.
//!
//! Every participant reads a topic of its own ([`topic_of`]), which ROS does not show; who has something to say to it
//! makes a writer for that. To readers of other kinds (rclpy, Cyclone DDS) the messages go on their topic as ever; this
//! suite's readers hear them there too and leave them.
//!
//! Latched writers go on as ever: their late readers are served by the middleware.

mod exchange;
mod inbox;
mod message;
mod outbox;
#[cfg(test)]
mod tests;

use crate::{
    Durability, Qos, Reliability,
    backend::{Channel, Endpoint, EndpointId, Sample},
    dds::{codec::Raw, lock::lock},
    mailbox::Mailbox,
};
use bytes::Bytes;
use inbox::Inbox;
use message::PartMessage;
use outbox::Outbox;
use rustdds::{GUID, QosPolicies, RTPSEntity as _, no_key::DataWriter};
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use tokio::sync::Notify;

pub(in crate::dds) use exchange::exchange;
pub(in crate::dds) use message::LARGEST;
pub(in crate::dds) use outbox::{Keep, Offered};

/// Decodes a sample as far as it goes: for the fuzz targets.
pub(crate) fn decode_part(sample: &[u8]) {
    PartMessage::decode(sample).ok();
}

/// A participant: the first bytes of the identities of its endpoints.
pub(in crate::dds) type Peer = [u8; 12];

/// Something to say to a participant.
#[derive(Clone, Debug)]
struct Mail {
    to: Peer,
    message: PartMessage,
}

/// In front of the participant's identity; the number is the protocol's version.
const TOPIC: &str = "wm/parts/1/";
pub(in crate::dds) const TYPE: &str = "wm::Parts_";
/// Samples that wait for the task that takes them, or for the thread that sends them.
const DEPTH: usize = 64;

/// How often a wait for readers looks whether one has fallen silent.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

/// Another participant that reads parts.
struct Postbox {
    reader: GUID,
    /// Made when there is something to say.
    writer: Option<DataWriter<Bytes, Raw>>,
}

/// A reader of a topic here.
struct LocalReader {
    inbox: Arc<Mailbox<Sample>>,
    depth: usize,
}

#[derive(Default)]
struct State {
    outbox: Outbox,
    inbox: Inbox,
    postboxes: BTreeMap<Peer, Postbox>,
    readers: BTreeMap<EndpointId, LocalReader>,
    /// The last number that a reader took on the topic of a writer (in this order), before it was known that the
    /// writer has gone over to parts.
    heard: BTreeMap<(EndpointId, EndpointId), i64>,
}

impl State {
    fn forget_peer(&mut self, peer: &Peer) {
        self.postboxes.remove(peer);
        self.outbox.forget_peer(peer);
        self.inbox.forget_peer(peer);
    }
}

/// The messages in parts of this participant.
#[derive(Default)]
pub(in crate::dds) struct Parts {
    state: Mutex<State>,
    /// There may be something to do earlier than before.
    is_earlier: Notify,
    /// A reader has settled a message.
    is_settled: Notify,
}

pub(in crate::dds) fn peer_of(id: &EndpointId) -> Peer {
    let mut peer = Peer::default();
    peer.copy_from_slice(&id[..12]);
    peer
}

pub(in crate::dds) fn topic_of(peer: &Peer) -> String {
    peer.iter()
        .fold(TOPIC.to_owned(), |name, byte| format!("{name}{byte:02x}"))
}

pub(in crate::dds) fn profile() -> QosPolicies {
    crate::dds::qos::for_writer(Qos::best_effort(DEPTH))
}

impl Keep {
    /// What a writer keeps whose messages may go in parts.
    pub(in crate::dds) fn of(endpoint: &Endpoint) -> Option<Self> {
        let Qos {
            reliability,
            durability,
            depth,
        } = endpoint.qos;
        if endpoint.channel != Channel::Topic || durability != Durability::Volatile {
            return None;
        }
        Some(match reliability {
            Reliability::BestEffort => Self::Last(depth),
            Reliability::Reliable => Self::All(crate::dds::qos::RELIABLE_WINDOW.max(depth)),
        })
    }
}

impl Parts {
    /// Whether a message goes in parts: it is large, or others of its writer went so before.
    pub(in crate::dds) fn takes(&self, writer: &EndpointId, len: usize) -> bool {
        len > message::PART || lock(&self.state).outbox.has(writer)
    }

    /// Whether this writer's messages go in parts.
    pub(in crate::dds) fn has(&self, writer: &EndpointId) -> bool {
        lock(&self.state).outbox.has(writer)
    }

    /// From now on this writer's messages go in parts. `last` is the last number that it used on its topic.
    pub(in crate::dds) fn open(&self, writer: EndpointId, keep: Keep, last: i64) {
        lock(&self.state).outbox.open(writer, keep, last);
    }

    /// Whether one more message would drop one that a reader still asks for.
    pub(in crate::dds) fn is_full(&self, writer: &EndpointId) -> bool {
        lock(&self.state).outbox.is_full(Instant::now(), writer)
    }

    /// Waits until every reader that is not silent has what this writer has sent so far.
    pub(in crate::dds) async fn acknowledged(&self, writer: &EndpointId) {
        let Some(last) = lock(&self.state).outbox.last(writer) else {
            return;
        };
        loop {
            let mut settled = std::pin::pin!(self.is_settled.notified());
            settled.as_mut().enable();
            if lock(&self.state)
                .outbox
                .is_settled(Instant::now(), writer, last)
            {
                return;
            }
            // looks again by itself: that a reader falls silent is no event
            tokio::time::timeout(LOOK_AGAIN, settled).await.ok();
        }
    }

    /// What comes in parts for this reader goes into `inbox`.
    pub(in crate::dds) fn add_reader(
        &self,
        id: EndpointId,
        endpoint: &Endpoint,
        inbox: &Arc<Mailbox<Sample>>,
    ) {
        let depth = match endpoint.qos.reliability {
            Reliability::BestEffort => endpoint.qos.depth,
            // as many as a reliable writer keeps: nothing that it still has is left out
            Reliability::Reliable => crate::dds::qos::RELIABLE_WINDOW.max(endpoint.qos.depth),
        };
        let inbox = Arc::clone(inbox);
        lock(&self.state)
            .readers
            .insert(id, LocalReader { inbox, depth });
    }

    /// Whether a sample on the topic is for this reader: not where it has come in parts, or will.
    pub(in crate::dds) fn lets_in(&self, reader: &EndpointId, sample: &Sample) -> bool {
        let mut state = lock(&self.state);
        if let Some(base) = state.inbox.base(&sample.writer) {
            return sample.sequence <= base;
        }
        if state.postboxes.contains_key(&peer_of(&sample.writer)) {
            let key = (*reader, sample.writer);
            state.heard.insert(key, sample.sequence);
        }
        true
    }

    /// A participant has a reader, which may be the one of parts. Told of each reader more than once.
    pub(in crate::dds) fn add_peer(&self, reader: GUID, topic: &str) {
        let peer = peer_of(&reader.to_bytes());
        if topic == topic_of(&peer) {
            let writer = None;
            let mut state = lock(&self.state);
            let postbox = Postbox { reader, writer };
            state.postboxes.entry(peer).or_insert(postbox);
        }
    }

    /// Another participant has gone.
    pub(in crate::dds) fn forget_participant(&self, peer: &Peer) {
        let mut state = lock(&self.state);
        state.forget_peer(peer);
        state
            .heard
            .retain(|(_, writer), _| peer_of(writer) != *peer);
        drop(state);
        self.is_settled.notify_waiters();
    }

    /// An endpoint of another participant has gone.
    pub(in crate::dds) fn forget_other(&self, id: &EndpointId) {
        let mut state = lock(&self.state);
        let peer = peer_of(id);
        let reader = state.postboxes.get(&peer).map(|postbox| postbox.reader);
        if reader.is_some_and(|reader| reader.to_bytes() == *id) {
            state.forget_peer(&peer);
        }
        state.inbox.forget_writer(id);
        state.heard.retain(|(_, writer), _| writer != id);
        drop(state);
        self.is_settled.notify_waiters();
    }

    /// The writers to other participants, each with its topic.
    pub(in crate::dds) fn writers(&self) -> Vec<(EndpointId, String)> {
        let state = lock(&self.state);
        let postboxes = state.postboxes.iter();
        let writer = |(peer, postbox): (&Peer, &Postbox)| {
            let id = postbox.writer.as_ref()?.guid().to_bytes();
            Some((id, topic_of(peer)))
        };
        postboxes.filter_map(writer).collect()
    }

    /// The readers of other participants that are known to take parts.
    pub(in crate::dds) fn readers(&self) -> Vec<EndpointId> {
        let state = lock(&self.state);
        let postboxes = state.postboxes.values();
        postboxes.map(|postbox| postbox.reader.to_bytes()).collect()
    }

    /// An endpoint of this participant has gone.
    pub(in crate::dds) fn forget_own(&self, id: &EndpointId) {
        let mut state = lock(&self.state);
        state.outbox.forget_writer(id);
        state.readers.remove(id);
        state.heard.retain(|(reader, _), _| reader != id);
    }

    /// Says nothing any more.
    pub(in crate::dds) fn leave(&self) {
        lock(&self.state).postboxes.clear();
    }
}
