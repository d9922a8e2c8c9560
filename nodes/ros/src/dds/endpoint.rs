//! Readers and writers of bytes.

use super::{
    answers::WaitingRoom,
    codec::{HEADER_LEN, Raw},
    local::{WAITING, is_same_participant},
    lock::lock,
    parts::{Keep, LARGEST, peer_of},
    shared::Shared,
};
use crate::{
    Durability, Error,
    backend::{Channel, Endpoint, EndpointId, Reader, RequestId, Sample, Sink, Writer, Written},
    mailbox::Mailbox,
};
use bytes::Bytes;
use futures::{StreamExt as _, future::BoxFuture};
use rustdds::{
    GUID, SequenceNumber, Timestamp, WriteOptionsBuilder,
    dds::result::WriteError,
    no_key::{DataWriter, DeserializedCacheChange, SimpleDataReader},
    rpc::SampleIdentity,
};
use std::sync::{Arc, Mutex};
use tokio::{runtime::Handle, task::AbortHandle};

pub(super) struct DdsWriter {
    core: Arc<WriterCore>,
    waiting: WaitingRoom,
    runtime: Handle,
}

/// What an answer that waits needs of its writer.
struct WriterCore {
    writer: DataWriter<Bytes, Raw>,
    topic: String,
    /// What is kept of messages in parts, where they may go so.
    keep: Option<Keep>,
    /// The last number on the topic. Held while a sample is sent, so that all readers get them in one order.
    last: Mutex<i64>,
    shared: Arc<Shared>,
}

impl WriterCore {
    fn id(&self) -> EndpointId {
        use rustdds::RTPSEntity as _;
        self.writer.guid().to_bytes()
    }

    fn send(&self, sample: &Bytes, answers: Option<RequestId>) -> Result<Written, Error> {
        let (id, mut last) = (self.id(), lock(&self.last));
        if let Some(keep) = self.keep
            && self.shared.parts.takes(&id, sample.len())
        {
            return self.send_in_parts(sample, keep, &mut last);
        }
        let written = self.send_whole(sample, answers, &mut last)?;
        if let Written::Sent(sequence) = written {
            self.shared.local.deliver(id, sequence, sample, answers);
        }
        Ok(written)
    }

    fn send_in_parts(&self, sample: &Bytes, keep: Keep, last: &mut i64) -> Result<Written, Error> {
        let (id, parts) = (self.id(), &self.shared.parts);
        if sample.len() > LARGEST {
            return Err(Error::MessageTooLarge {
                topic: self.topic.clone(),
                len: sample.len(),
                largest: LARGEST,
            });
        }
        parts.open(id, keep, *last);
        if parts.is_full(&id) {
            return Ok(Written::WindowFull);
        }
        let (peers, has_others) = self.shared.readers_in_parts(&id);
        let copy = match has_others {
            false => 0,
            true => match self.send_whole(sample, None, last)? {
                Written::Sent(sequence) => sequence,
                not_sent => return Ok(not_sent),
            },
        };
        let number = self.shared.offer(&id, sample, copy, peers);
        let Some(number) = number else {
            return Err(Error::ShutDown(self.topic.clone()));
        };
        self.shared.local.deliver(id, number, sample, None);
        Ok(Written::Sent(number))
    }

    /// On the topic, to readers elsewhere.
    fn send_whole(
        &self,
        sample: &Bytes,
        answers: Option<RequestId>,
        last: &mut i64,
    ) -> Result<Written, Error> {
        if self.shared.is_alone {
            // there is nobody elsewhere, and own readers would never acknowledge
            *last += 1;
            return Ok(Written::Sent(*last));
        }
        let related = answers.map(|request| SampleIdentity {
            writer_guid: GUID::from_bytes(request.client),
            sequence_number: SequenceNumber::from(request.sequence),
        });
        let options = WriteOptionsBuilder::new()
            .source_timestamp(Timestamp::now())
            .related_sample_identity_opt(related)
            .build();
        match self.writer.write_with_options(sample.clone(), options) {
            Ok(identity) => {
                let sequence = identity.sequence_number.into();
                *last = sequence;
                Ok(Written::Sent(sequence))
            }
            Err(WriteError::WouldBlock { .. }) => Ok(Written::WindowFull),
            Err(error) => Err(Error::middleware(format!("publish {}", self.topic), error)),
        }
    }
}

impl DdsWriter {
    pub(super) fn new(
        writer: DataWriter<Bytes, Raw>,
        endpoint: &Endpoint,
        node: &str,
        shared: &Arc<Shared>,
        runtime: &Handle,
    ) -> Self {
        use rustdds::RTPSEntity as _;
        // offers come from the first participant, and are for its writers
        let is_of_first = peer_of(&writer.guid().to_bytes()) == shared.first;
        let this = Self {
            core: Arc::new(WriterCore {
                writer,
                topic: endpoint.name.clone(),
                keep: Keep::of(endpoint).filter(|_| is_of_first),
                last: Mutex::new(0),
                shared: Arc::clone(shared),
            }),
            waiting: WaitingRoom::default(),
            runtime: runtime.clone(),
        };
        shared.local.add_writer(this.id(), endpoint);
        shared.nodes.add_endpoint(this.id(), node, endpoint, true);
        shared.changed();
        this
    }

    /// Has an answer sent when its client is connected; false where too many wait already.
    fn hold(&self, sample: &Bytes, request: RequestId) -> bool {
        let Some(place) = self.waiting.enter() else {
            return false;
        };
        let (core, id) = (Arc::downgrade(&self.core), self.id());
        let (shared, sample) = (Arc::clone(&self.core.shared), sample.clone());
        self.runtime.spawn(async move {
            let _place = place;
            let is_reached = shared.reached(&id, &request.client).await;
            let Some(core) = core.upgrade() else { return };
            let topic = &core.topic;
            if !is_reached {
                tracing::warn!("{topic}: a call is not answered: its client cannot be reached");
                return;
            }
            match core.send(&sample, Some(request)) {
                Ok(Written::WindowFull) => {
                    tracing::warn!("{topic}: a call is not answered: clients do not take answers");
                }
                Ok(_) => {}
                Err(error) => tracing::warn!("{topic}: a call is not answered: {error}"),
            }
        });
        true
    }
}

impl Writer for DdsWriter {
    fn id(&self) -> EndpointId {
        self.core.id()
    }

    fn write(&self, sample: &Bytes, answers: Option<RequestId>) -> Result<Written, Error> {
        match sample.get(..HEADER_LEN) {
            Some([0x00, 0x01, ..]) => {}
            header => {
                let byte = |index| {
                    header
                        .and_then(|header| header.get(index))
                        .copied()
                        .unwrap_or(0xff)
                };
                let representation = u16::from_be_bytes([byte(0), byte(1)]);
                return Err(Error::Representation {
                    topic: self.core.topic.clone(),
                    representation,
                });
            }
        }
        if let Some(RequestId { client, .. }) = &answers
            && !is_same_participant(&self.id(), client)
        {
            let largest = self.core.shared.largest_answer(&self.id(), client);
            if sample.len() > largest {
                return Err(Error::AnswerTooLarge {
                    service: self.core.topic.clone(),
                    len: sample.len(),
                    largest,
                });
            }
        }
        if let Some(request) = answers
            && !self.core.shared.reaches(&self.id(), &request.client)
            && self.hold(sample, request)
        {
            return Ok(Written::Held);
        }
        self.core.send(sample, answers)
    }

    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>> {
        Box::pin(async move {
            let wait = self.core.writer.async_wait_for_acknowledgments();
            wait.await.map(drop).map_err(|error| {
                Error::middleware(
                    format!("wait for the readers of {}", self.core.topic),
                    error,
                )
            })?;
            self.core.shared.parts.acknowledged(&self.id()).await;
            Ok(())
        })
    }
}

impl Drop for DdsWriter {
    fn drop(&mut self) {
        self.core.shared.forget(&self.id());
    }
}

pub(super) struct DdsReader {
    id: EndpointId,
    shared: Arc<Shared>,
    pump: AbortHandle,
}

impl DdsReader {
    /// `began` is a moment before the reader was made: what comes after it is for this one.
    pub(super) fn new(
        reader: SimpleDataReader<Bytes, Raw>,
        began: Timestamp,
        endpoint: &Endpoint,
        node: &str,
        shared: &Arc<Shared>,
        mut sink: Sink,
        runtime: &Handle,
    ) -> Self {
        let id = reader.guid().to_bytes();
        let inbox = if endpoint.hears_own {
            shared.local.add_reader(id, endpoint)
        } else {
            Arc::new(Mailbox::new(WAITING))
        };
        let is_topic = endpoint.channel == Channel::Topic;
        if is_topic {
            shared.parts.add_reader(id, endpoint, &inbox);
        }
        shared.nodes.add_endpoint(id, node, endpoint, false);
        shared.changed();
        let is_server = endpoint.channel == Channel::Request;
        let is_latched = endpoint.qos.durability == Durability::TransientLocal;
        let book = Arc::clone(shared);
        let mut began = Some(began);
        let pump = runtime.spawn(async move {
            let mut samples = std::pin::pin!(reader.as_async_stream());
            loop {
                let sample = tokio::select! {
                    Some(sample) = inbox.pop() => Ok(sample),
                    Some(sample) = samples.next() => match sample {
                        Ok(change) => {
                            let writer = change.writer_guid().to_bytes();
                            if book.is_own(&writer) {
                                continue;
                            }
                            if began.is_some_and(|began| change.receive_instant < began) {
                                // rustdds keeps a topic's last samples for all readers: one that comes anew would
                                // get those of the one before, and of writers that are gone
                                if !(is_latched && book.is_there(&writer)) {
                                    continue;
                                }
                            } else {
                                // from here on they come in their order, whatever becomes of the system's clock
                                began = None;
                            }
                            let sample = into_sample(change, is_server);
                            if is_topic && !book.parts.lets_in(&id, &sample) {
                                continue;
                            }
                            Ok(sample)
                        }
                        Err(error) => Err(error.to_string()),
                    },
                    else => break,
                };
                sink(sample);
            }
        });
        Self {
            id,
            shared: Arc::clone(shared),
            pump: pump.abort_handle(),
        }
    }
}

fn into_sample(change: DeserializedCacheChange<Bytes>, is_server: bool) -> Sample {
    let (writer, sequence) = (
        change.writer_guid().to_bytes(),
        i64::from(change.sequence_number),
    );
    let mut request = change.related_sample_identity().map(|identity| RequestId {
        client: identity.writer_guid.to_bytes(),
        sequence: identity.sequence_number.into(),
    });
    if is_server {
        // A client may leave out who it is, or (Fast DDS) the number: the sample's own are meant then.
        let request = request.get_or_insert(RequestId {
            client: writer,
            sequence,
        });
        if request.sequence == i64::from(SequenceNumber::UNKNOWN) {
            request.sequence = sequence;
        }
    }
    Sample {
        writer,
        sequence,
        request,
        bytes: change.into_value(),
    }
}

impl Reader for DdsReader {
    fn id(&self) -> EndpointId {
        self.id
    }
}

impl Drop for DdsReader {
    fn drop(&mut self) {
        // the reader lives in the task, and goes with it
        self.pump.abort();
        self.shared.forget(&self.id);
    }
}
