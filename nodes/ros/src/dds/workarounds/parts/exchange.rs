//! Connects the parts protocol with DDS and with the readers in this process.

use super::{
    Postbox, State, TYPE,
    inbox::WholeMessage,
    message::{Mail, PartMessage},
    outbox::OfferOutcome,
    profile, topic_of,
};
use crate::{
    Error,
    backend::{EndpointId, Sample},
    dds::identity::participant_of,
    dds::{
        codec::Raw,
        identity::{Peer, is_same_participant},
        shared::Shared,
    },
    lock::lock,
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
    /// The reader of messages to this participant.
    pub(in crate::dds) fn parts_reader(
        &self,
        own: &EndpointId,
    ) -> Result<SimpleDataReader<Bytes, Raw>, Error> {
        let name = topic_of(&participant_of(own));
        let topic = self.parts_topic(name.clone())?;
        self.subscriber
            .create_simple_datareader_no_key(&topic, Some(profile()))
            .map_err(|error| Error::middleware(format!("subscribe to {name}"), error))
    }

    /// The participants that take this writer's messages in parts, and whether other readers exist.
    pub(in crate::dds) fn readers_in_parts(&self, writer: &EndpointId) -> (BTreeSet<Peer>, bool) {
        let state = lock(&self.parts.state);
        self.split(&state, writer)
    }

    fn split(&self, state: &State, writer: &EndpointId) -> (BTreeSet<Peer>, bool) {
        let matches = lock(&self.matches);
        let readers = matches
            .get(writer)
            .into_iter()
            .flatten()
            .map(participant_of);
        let (with, without): (BTreeSet<Peer>, BTreeSet<Peer>) =
            readers.partition(|peer| state.postboxes.contains_key(peer));
        (with, !without.is_empty())
    }

    pub(in crate::dds) fn offer(
        &self,
        writer: &EndpointId,
        bytes: &Bytes,
        copy: i64,
        peers: BTreeSet<Peer>,
    ) -> Option<OfferOutcome> {
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

    /// Handles a message from another participant.
    fn take(&self, from: &EndpointId, message: PartMessage) {
        let (now, mut mail) = (Instant::now(), Vec::new());
        let peer = participant_of(from);
        let sender = message.required_sender();
        if sender.is_some_and(|writer| !is_same_participant(from, writer)) {
            tracing::debug!("dropping a part: its writer belongs to another participant");
            return;
        }
        let mut state = lock(&self.parts.state);
        match message {
            PartMessage::Offer { of, first, head } => {
                // without a reader, the writer drops this participant or repeats the offer
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

    /// Does everything that is due. Returns when the next action is due.
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

    /// The depth of the deepest connected reader of this writer in this process.
    fn depth(&self, state: &State, writer: &EndpointId) -> Option<usize> {
        let matches = lock(&self.matches);
        let readers = state.readers.iter().filter(|(id, _)| {
            matches
                .get(*id)
                .is_some_and(|writers| writers.contains(writer))
        });
        readers.map(|(_, reader)| reader.depth).max()
    }

    fn hand_over(&self, state: &State, whole: WholeMessage) {
        let WholeMessage { of, bytes } = whole;
        let writer = of.id.writer;
        let matches = lock(&self.matches);
        for (id, reader) in &state.readers {
            let is_connected = matches
                .get(id)
                .is_some_and(|writers| writers.contains(&writer));
            let last = state.last_on_topic.get(&(*id, writer));
            let has_copy = of.copy > 0 && last.is_some_and(|last| *last >= of.copy);
            if is_connected && !has_copy {
                reader.inbox.push(Sample {
                    payload: Payload::Cdr(bytes.clone()),
                    writer,
                    sequence: of.id.number,
                    arrived: Instant::now(),
                    request: None,
                });
            }
        }
    }

    /// Sends to connected participants. The protocol repeats lost messages.
    fn send(&self, state: &mut State, mail: Vec<Mail>) {
        for Mail { to, message } in mail {
            let Some(postbox) = state.postboxes.get_mut(&to) else {
                continue;
            };
            let reader = postbox.reader;
            if postbox.writer.is_none() && self.catch_up.is_pending() {
                continue; // a new endpoint has to wait
            }
            let sent = self.writer_of(postbox, &to).and_then(|writer| {
                let matches = lock(&self.matches);
                let connected = matches.get(&writer.guid().to_bytes());
                if !connected.is_some_and(|others| others.contains(&reader.to_bytes())) {
                    return Ok(()); // not connected yet
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

/// Receives the messages to this participant, and repeats messages when due.
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
                        Err(error) => tracing::debug!("dropping an invalid part: {error}"),
                    }
                }
                Some(Err(error)) => tracing::debug!("dropping an invalid part: {error}"),
            },
            () = wait => {}
            () = shared.parts.is_earlier.notified() => {}
        }
    }
}
