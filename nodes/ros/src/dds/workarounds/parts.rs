//! Large messages between participants of this suite, for receive buffers of any size.
//!
//! rustdds sends a sample as one burst of fragments. A burst of 512 KiB overflows Linux's default receive buffer of 208
//! KiB, and so do rustdds' repairs. So a volatile writer switches to parts with its first large message:
//! - It offers each message to the participants that read the topic and have a reader of parts. It keeps as many
//!   messages as its history is deep.
//! - A reader requests a few parts at a time, so that nothing overflows. It repeats requests without a reply, and
//!   acknowledges complete messages.
//! - A stopped reader delays no other. It loses the oldest messages if too many wait, and all but the newest after some
//!   seconds of silence.
//! - A writer sends a part only to readers that received the offer.
//!
//! Every participant reads a topic of its own ([`topic_of`]), which ROS tools hide. Senders make a writer for it.
//! Readers of other implementations (rclpy, Cyclone DDS) receive the messages on the ordinary topic; readers of this
//! suite ignore them there.
//!
//! Latched writers do not use parts: rustdds serves their late readers.

pub(in crate::dds) mod exchange;
mod inbox;
pub(in crate::dds) mod message;
pub(in crate::dds) mod outbox;
#[cfg(test)]
mod tests;

use crate::{
    Durability, Qos, Reliability,
    backend::{Channel, Endpoint, EndpointId, Sample},
    dds::identity::participant_of,
    dds::{codec::Raw, identity::Peer, own_endpoints::OwnEndpoint, qos},
    lock::lock,
    mailbox::Mailbox,
};
use bytes::Bytes;
use inbox::Inbox;
use message::PartMessage;
use outbox::{Outbox, Retention};
use rustdds::{GUID, QosPolicies, RTPSEntity as _, no_key::DataWriter};
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use tokio::sync::Notify;

/// For the fuzz targets.
pub(crate) fn decode_part(sample: &[u8]) {
    PartMessage::decode(sample).ok();
}

/// The participant's identity follows; the number is the version of the protocol.
const TOPIC: &str = "wm/parts/1/";
const TYPE: &str = "wm::Parts_";
/// Samples that wait for the receiving task or the sending thread.
const DEPTH: usize = 64;

/// How often a wait checks for readers that have become silent.
const CHECK_PERIOD: Duration = Duration::from_millis(500);

/// Another participant that reads parts.
struct Postbox {
    reader: GUID,
    /// Made for the first message.
    writer: Option<DataWriter<Bytes, Raw>>,
}

/// A reader in this process.
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
    /// By reader and writer: the last number that the reader took on the topic, before the writer was known to use
    /// parts.
    last_on_topic: BTreeMap<(EndpointId, EndpointId), i64>,
}

impl State {
    fn forget_peer(&mut self, peer: &Peer) {
        self.postboxes.remove(peer);
        self.outbox.forget_peer(peer);
        self.inbox.forget_peer(peer);
    }
}

/// The parts protocol of this participant.
#[derive(Default)]
pub(in crate::dds) struct Parts {
    state: Mutex<State>,
    /// There may be something to do earlier than planned.
    is_earlier: Notify,
    /// A reader has acknowledged a message.
    is_settled: Notify,
}

pub(in crate::dds) fn topic_of(peer: &Peer) -> String {
    peer.iter()
        .fold(TOPIC.to_owned(), |name, byte| format!("{name}{byte:02x}"))
}

fn profile() -> QosPolicies {
    qos::for_writer(Qos::best_effort(DEPTH))
}

/// An endpoint of the parts protocol.
pub(in crate::dds) fn endpoint(topic: String, is_writer: bool) -> OwnEndpoint {
    OwnEndpoint {
        topic,
        type_name: TYPE.to_owned(),
        qos: profile(),
        is_writer,
    }
}

impl Retention {
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
            Reliability::Reliable => Self::All(qos::RELIABLE_WINDOW.max(depth)),
        })
    }
}

impl Parts {
    /// Whether a message goes in parts: it is large, or its writer uses parts already.
    pub(in crate::dds) fn takes(&self, writer: &EndpointId, len: usize) -> bool {
        len > message::PART || lock(&self.state).outbox.has(writer)
    }

    /// Whether this writer uses parts.
    pub(in crate::dds) fn has(&self, writer: &EndpointId) -> bool {
        lock(&self.state).outbox.has(writer)
    }

    /// Switches this writer to parts. `last`: the last number that it used on its topic.
    pub(in crate::dds) fn open(&self, writer: EndpointId, keep: Retention, last: i64) {
        lock(&self.state).outbox.open(writer, keep, last);
    }

    /// Whether one more message would drop one that a reader still requests.
    pub(in crate::dds) fn is_full(&self, writer: &EndpointId) -> bool {
        lock(&self.state).outbox.is_full(Instant::now(), writer)
    }

    /// Waits until every reader that is not silent has all messages of this writer.
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
            // checks again: there is no event for a silent reader
            tokio::time::timeout(CHECK_PERIOD, settled).await.ok();
        }
    }

    /// Messages in parts for this reader go into `inbox`.
    pub(in crate::dds) fn add_reader(
        &self,
        id: EndpointId,
        endpoint: &Endpoint,
        inbox: &Arc<Mailbox<Sample>>,
    ) {
        let depth = match endpoint.qos.reliability {
            Reliability::BestEffort => endpoint.qos.depth,
            // as many as a reliable writer keeps
            Reliability::Reliable => qos::RELIABLE_WINDOW.max(endpoint.qos.depth),
        };
        let inbox = Arc::clone(inbox);
        lock(&self.state)
            .readers
            .insert(id, LocalReader { inbox, depth });
    }

    /// Whether to deliver a sample from the topic: not if it arrives in parts too.
    pub(in crate::dds) fn delivers(&self, reader: &EndpointId, sample: &Sample) -> bool {
        let mut state = lock(&self.state);
        if let Some(base) = state.inbox.base(&sample.writer) {
            return sample.sequence <= base;
        }
        if state
            .postboxes
            .contains_key(&participant_of(&sample.writer))
        {
            let key = (*reader, sample.writer);
            state.last_on_topic.insert(key, sample.sequence);
        }
        true
    }

    /// A participant has a reader, perhaps its reader of parts. Called repeatedly for each reader.
    pub(in crate::dds) fn add_peer(&self, reader: GUID, topic: &str) {
        let peer = participant_of(&reader.to_bytes());
        if topic == topic_of(&peer) {
            let writer = None;
            let mut state = lock(&self.state);
            let postbox = Postbox { reader, writer };
            state.postboxes.entry(peer).or_insert(postbox);
        }
    }

    pub(in crate::dds) fn forget_participant(&self, peer: &Peer) {
        let mut state = lock(&self.state);
        state.forget_peer(peer);
        state
            .last_on_topic
            .retain(|(_, writer), _| participant_of(writer) != *peer);
        drop(state);
        self.is_settled.notify_waiters();
    }

    pub(in crate::dds) fn forget_other(&self, id: &EndpointId) {
        let mut state = lock(&self.state);
        let peer = participant_of(id);
        let reader = state.postboxes.get(&peer).map(|postbox| postbox.reader);
        if reader.is_some_and(|reader| reader.to_bytes() == *id) {
            state.forget_peer(&peer);
        }
        state.inbox.forget_writer(id);
        state.last_on_topic.retain(|(_, writer), _| writer != id);
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

    /// The readers of parts of other participants.
    pub(in crate::dds) fn readers(&self) -> Vec<EndpointId> {
        let state = lock(&self.state);
        let postboxes = state.postboxes.values();
        postboxes.map(|postbox| postbox.reader.to_bytes()).collect()
    }

    pub(in crate::dds) fn forget_own(&self, id: &EndpointId) {
        let mut state = lock(&self.state);
        state.outbox.forget_writer(id);
        state.readers.remove(id);
        state.last_on_topic.retain(|(reader, _), _| reader != id);
    }

    /// Sends nothing from now on.
    pub(in crate::dds) fn leave(&self) {
        lock(&self.state).postboxes.clear();
    }
}
