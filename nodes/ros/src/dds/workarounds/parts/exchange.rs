//! Carries out the decisions of the parts protocol: sends them to other participants, and hands messages to the readers
//! here.

use super::{
    Mail, Offered, Peer, Postbox, State, TYPE, inbox::Whole, message::PartMessage, peer_of,
    profile, topic_of,
};
use crate::{
    Error,
    backend::{EndpointId, Sample},
    dds::{codec::Raw, local::is_same_participant, lock::lock, shared::Shared},
    payload::Payload,
};
use bytes::Bytes;
use futures::StreamExt as _;
use rustdds::{
    RTPSEntity as _, TopicKind, WriteOptionsBuilder,
    no_key::{DataWriter, SimpleDataReader},
};
use std::{collections::BTreeSet, sync::Arc, time::Instant};

impl Shared {
    /// The reader of what others say to this participant.
    pub(in crate::dds) fn parts_reader(
        &self,
        own: &EndpointId,
    ) -> Result<SimpleDataReader<Bytes, Raw>, Error> {
        let name = topic_of(&peer_of(own));
        let topic = self.parts_topic(name.clone())?;
        self.subscriber
            .create_simple_datareader_no_key(&topic, Some(profile()))
            .map_err(|error| Error::middleware(format!("subscribe to {name}"), error))
    }

    /// The participants that take this writer's messages in parts, and whether there are readers that do not.
    pub(in crate::dds) fn readers_in_parts(&self, writer: &EndpointId) -> (BTreeSet<Peer>, bool) {
        let state = lock(&self.parts.state);
        self.split(&state, writer)
    }

    fn split(&self, state: &State, writer: &EndpointId) -> (BTreeSet<Peer>, bool) {
        let matches = lock(&self.matches);
        let readers = matches.get(writer).into_iter().flatten().map(peer_of);
        let (with, without): (BTreeSet<Peer>, BTreeSet<Peer>) =
            readers.partition(|peer| state.postboxes.contains_key(peer));
        (with, !without.is_empty())
    }

    /// Offers a message to those who take it in parts.
    pub(in crate::dds) fn offer(
        &self,
        writer: &EndpointId,
        bytes: &Bytes,
        copy: i64,
        peers: BTreeSet<Peer>,
    ) -> Option<Offered> {
        let (now, mut mail) = (Instant::now(), Vec::new());
        let mut state = lock(&self.parts.state);
        let offered = state
            .outbox
            .offer(now, writer, bytes, copy, peers, &mut mail);
        self.send(&mut state, mail);
        drop(state);
        self.parts.is_earlier.notify_one();
        offered
    }

    /// Something came for this participant.
    fn take(&self, from: &EndpointId, message: PartMessage) {
        let (now, mut mail) = (Instant::now(), Vec::new());
        let peer = peer_of(from);
        let speaker = message.speaker();
        if speaker.is_some_and(|writer| !is_same_participant(from, writer)) {
            tracing::debug!("not a part: its writer is another participant's");
            return;
        }
        let mut state = lock(&self.parts.state);
        match message {
            PartMessage::Offer { of, first, head } => {
                // no reader: none yet, or no more; the writer will know or ask again
                if let Some(depth) = self.depth(&state, &of.id.writer) {
                    let offer = (of, first, head);
                    state.inbox.offered(now, peer, offer, depth, &mut mail);
                }
            }
            PartMessage::Part { of, index, bytes } => state.inbox.came(now, of, index, bytes),
            PartMessage::Gone { id } => state.inbox.gone(&id),
            PartMessage::Want { id, index } => {
                state.outbox.wanted(now, peer, id, index, &mut mail);
            }
            PartMessage::Settled { id } => {
                state.outbox.settled(now, peer, id);
                self.parts.is_settled.notify_waiters();
            }
        }
        self.send(&mut state, mail);
    }

    /// Does what is due; when there is more to do.
    fn advance(&self) -> Option<Instant> {
        let (now, mut mail) = (Instant::now(), Vec::new());
        let mut state = lock(&self.parts.state);
        let wholes = state.inbox.advance(now, &mut mail);
        for whole in wholes {
            self.hand_over(&state, whole);
        }
        let mut outbox = std::mem::take(&mut state.outbox);
        outbox.repeat(now, |writer| self.split(&state, writer).0, &mut mail);
        state.outbox = outbox;
        self.send(&mut state, mail);
        state
            .inbox
            .due()
            .into_iter()
            .chain(state.outbox.due())
            .min()
    }

    /// The depth of the deepest reader here that is connected to this writer.
    fn depth(&self, state: &State, writer: &EndpointId) -> Option<usize> {
        let matches = lock(&self.matches);
        let readers = state.readers.iter().filter(|(id, _)| {
            matches
                .get(*id)
                .is_some_and(|writers| writers.contains(writer))
        });
        readers.map(|(_, reader)| reader.depth).max()
    }

    fn hand_over(&self, state: &State, whole: Whole) {
        let Whole { of, bytes } = whole;
        let writer = of.id.writer;
        let matches = lock(&self.matches);
        for (id, reader) in &state.readers {
            let is_connected = matches
                .get(id)
                .is_some_and(|writers| writers.contains(&writer));
            let heard = state.heard.get(&(*id, writer));
            let has_copy = of.copy > 0 && heard.is_some_and(|heard| *heard >= of.copy);
            if is_connected && !has_copy {
                reader.inbox.push(Sample {
                    payload: Payload::Cdr(bytes.clone()),
                    writer,
                    sequence: of.id.number,
                    request: None,
                });
            }
        }
    }

    /// Sends what can be sent: what is lost is said again.
    fn send(&self, state: &mut State, mail: Vec<Mail>) {
        for Mail { to, message } in mail {
            let Some(postbox) = state.postboxes.get_mut(&to) else {
                continue;
            };
            let reader = postbox.reader;
            if postbox.writer.is_none() && self.catch_up.is_pending() {
                continue; // not yet
            }
            let sent = self.writer_of(postbox, &to).and_then(|writer| {
                let matches = lock(&self.matches);
                let connected = matches.get(&writer.guid().to_bytes());
                if !connected.is_some_and(|others| others.contains(&reader.to_bytes())) {
                    return Ok(()); // not yet
                }
                drop(matches);
                let bytes = message.encode()?;
                let options = WriteOptionsBuilder::new().to_single_reader(reader).build();
                let written = writer.write_with_options(bytes, options);
                written
                    .map(drop)
                    .map_err(|error| Error::middleware("send a part", error))
            });
            if let Err(error) = sent {
                tracing::debug!("{error}");
            }
        }
    }

    fn writer_of<'a>(
        &self,
        postbox: &'a mut Postbox,
        peer: &Peer,
    ) -> Result<&'a DataWriter<Bytes, Raw>, Error> {
        if postbox.writer.is_none() {
            let name = topic_of(peer);
            let topic = self.parts_topic(name.clone())?;
            let writer = self
                .publisher
                .create_datawriter_no_key(&topic, Some(profile()));
            let failed = |error| Error::middleware(format!("publish {name}"), error);
            postbox.writer = Some(writer.map_err(failed)?);
        }
        match &postbox.writer {
            Some(writer) => Ok(writer),
            None => Err(Error::ShutDown(topic_of(peer))),
        }
    }

    fn parts_topic(&self, name: String) -> Result<rustdds::Topic, Error> {
        let participant = lock(&self.participant);
        let Some(participant) = participant.as_ref() else {
            return Err(Error::ShutDown(name));
        };
        let failed = |error| Error::middleware(format!("create the topic {name}"), error);
        participant
            .create_topic(name.clone(), TYPE.to_owned(), &profile(), TopicKind::NoKey)
            .map_err(failed)
    }
}

/// Reads what others say to this participant, and keeps the times at which something is said again.
pub(in crate::dds) async fn exchange(reader: SimpleDataReader<Bytes, Raw>, shared: Arc<Shared>) {
    let mut samples = std::pin::pin!(reader.as_async_stream());
    loop {
        let due = shared.advance();
        let wait = async {
            match due {
                Some(due) => tokio::time::sleep_until(due.into()).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            sample = samples.next() => match sample {
                None => return,
                Some(Ok(change)) => {
                    let from = change.writer_guid().to_bytes();
                    match PartMessage::decode(&change.into_value()) {
                        Ok(message) => shared.take(&from, message),
                        Err(error) => tracing::debug!("not a part: {error}"),
                    }
                }
                Some(Err(error)) => tracing::debug!("not a part: {error}"),
            },
            () = wait => {}
            () = shared.parts.is_earlier.notified() => {}
        }
    }
}
