//! Writers of bytes.

use super::{
    answers::WaitingRoom,
    codec::{HEADER_LEN, Raw},
    lock::lock,
    parts::{Keep, LARGEST, Offered, peer_of},
    rtps::LARGEST_ANSWER,
    shared::{Shared, is_foreign},
    window::{Release, Window},
    wire::Answer,
};
use crate::{
    Durability, Error, Reliability,
    backend::{Audience, Channel, Endpoint, EndpointId, RequestId, WhenFull, Writer, Written},
    clock::system_nanos,
    payload::Payload,
};
use bytes::Bytes;
use futures::future::BoxFuture;
use rustdds::{
    GUID, SequenceNumber, Timestamp, WriteOptionsBuilder, dds::result::WriteError,
    no_key::DataWriter, rpc::SampleIdentity,
};
use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use tokio::runtime::Handle;

/// How long to wait before an answer that is not acknowledged is sent again \[ms\].
const REPEAT_ANSWER: [u64; 5] = [50, 100, 200, 400, 800];

/// How long a writer stays after its last sample: rustdds 0.15.1 forgets what its reader has acknowledged, and not handed
/// over yet, when the writer leaves (`TopicCache::forget_reliable_writer`). The last answer of a service, and the last
/// messages of a node, would be lost where their receiver is short of time.
pub(super) const HAND_OVER: Duration = Duration::from_millis(250);

pub(super) struct DdsWriter {
    core: Arc<WriterCore>,
    waiting: WaitingRoom,
}

/// What an answer that waits needs of its writer.
struct WriterCore {
    writer: Arc<DataWriter<Bytes, Raw>>,
    topic: String,
    /// What is kept of messages in parts, where they may go so.
    keep: Option<Keep>,
    is_topic: bool,
    is_reliable: bool,
    is_latched: bool,
    /// Held while a sample is sent, so that all readers get them in one order.
    sent: Mutex<Sent>,
    shared: Arc<Shared>,
    runtime: Handle,
}

/// What went out so far.
struct Sent {
    /// On the topic.
    window: Window,
    /// To readers of this participant: those elsewhere may miss what nobody there heard, these do not.
    here: i64,
    /// When the last sample went out to readers elsewhere.
    last: Option<Instant>,
}

impl WriterCore {
    fn id(&self) -> EndpointId {
        use rustdds::RTPSEntity as _;
        self.writer.guid().to_bytes()
    }

    /// Whether there are readers elsewhere, or may be such that want what was sent before.
    fn is_heard_elsewhere(&self) -> bool {
        let is_matched = || lock(&self.shared.matches).contains_key(&self.id());
        !self.shared.is_alone && (self.is_latched || is_matched())
    }

    fn send(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        when_full: WhenFull,
    ) -> Result<Written, Error> {
        let mut sent = lock(&self.sent);
        // calls are known by their number on the wire
        let written = if !self.is_topic || self.is_heard_elsewhere() {
            let sample = payload.cdr()?;
            sent.last = Some(Instant::now());
            self.send_elsewhere(&sample, answers, when_full, &mut sent.window)?
        } else {
            Written::Sent {
                number: sent.window.last(),
                dropped: 0,
            }
        };
        let Written::Sent { number, .. } = written else {
            return Ok(written);
        };
        sent.here += 1;
        let number = if self.is_topic { sent.here } else { number };
        let local = &self.shared.local;
        local.deliver(self.id(), number, payload, answers);
        Ok(written)
    }

    fn check(&self, sample: &Bytes) -> Result<(), Error> {
        let header = sample.get(..HEADER_LEN);
        if let Some([0x00, 0x01, ..]) = header {
            return Ok(());
        }
        let representation = header.and_then(|header| Some(*header.first_chunk::<2>()?));
        Err(Error::Representation {
            topic: self.topic.clone(),
            representation: representation.map_or(0xffff, u16::from_be_bytes),
        })
    }

    fn send_elsewhere(
        &self,
        sample: &Bytes,
        answers: Option<RequestId>,
        when_full: WhenFull,
        window: &mut Window,
    ) -> Result<Written, Error> {
        if self.shared.is_alone {
            // there is nobody elsewhere, and own readers would never acknowledge
            let number = window.last() + 1;
            window.wrote(number, 0);
            return Ok(Written::Sent { number, dropped: 0 });
        }
        if let Some(keep) = self.keep
            && self.shared.parts.takes(&self.id(), sample.len())
        {
            return self.send_in_parts(sample, keep, when_full, window);
        }
        match answers {
            Some(request) => self.send_answer(sample, request, when_full, window),
            None => self.send_whole(sample, None, when_full, window),
        }
    }

    fn send_in_parts(
        &self,
        sample: &Bytes,
        keep: Keep,
        when_full: WhenFull,
        window: &mut Window,
    ) -> Result<Written, Error> {
        let (id, parts) = (self.id(), &self.shared.parts);
        self.check_len(sample.len(), LARGEST)?;
        parts.open(id, keep, window.last());
        if when_full == WhenFull::Refuse && parts.is_full(&id) {
            return Ok(Written::WindowFull);
        }
        let (peers, has_others) = self.shared.readers_in_parts(&id);
        let (copy, dropped_elsewhere) = match has_others {
            false => (0, 0),
            true => match self.send_whole(sample, None, when_full, window)? {
                Written::Sent { number, dropped } => (number, dropped),
                not_sent => return Ok(not_sent),
            },
        };
        let offered = self.shared.offer(&id, sample, copy, peers);
        let Some(Offered { number, dropped }) = offered else {
            return Err(Error::ShutDown(self.topic.clone()));
        };
        Ok(Written::Sent {
            number,
            dropped: dropped + dropped_elsewhere,
        })
    }

    fn check_len(&self, len: usize, largest: usize) -> Result<(), Error> {
        if len <= largest {
            return Ok(());
        }
        let topic = self.topic.clone();
        Err(Error::MessageTooLarge {
            topic,
            len,
            largest,
        })
    }

    /// Sends an answer, by itself where rustdds would spoil it.
    fn send_answer(
        &self,
        sample: &Bytes,
        request: RequestId,
        when_full: WhenFull,
        window: &mut Window,
    ) -> Result<Written, Error> {
        let (id, shared) = (self.id(), &self.shared);
        let clients = shared.matched(&id);
        if sample.len() <= shared.largest_answer(&id, &clients) {
            return self.send_whole(sample, Some(request), when_full, window);
        }
        if sample.len() > LARGEST_ANSWER {
            return Err(Error::AnswerTooLarge {
                service: self.topic.clone(),
                len: sample.len(),
                largest: LARGEST_ANSWER,
            });
        }
        let answer = Answer {
            writer: id,
            number: window.last() + 1,
            request,
            nanos: system_nanos(),
            sample: sample.clone(),
        };
        // all of them: clients of one service take all answers, and wait for one that is missing
        let addresses = shared.addresses_of(&clients);
        let send = {
            let shared = Arc::clone(shared);
            move || {
                for (client, addresses) in &addresses {
                    shared.wire.answer(&answer, client, addresses);
                }
            }
        };
        send();
        let written = self.send_whole(sample, Some(request), when_full, window)?;
        // a datagram may be lost
        let writer = Arc::downgrade(&self.writer);
        shared.failure.watch(&self.runtime, "answers", async move {
            for pause in REPEAT_ANSWER {
                let Some(writer) = writer.upgrade() else {
                    return;
                };
                let acknowledged = writer.async_wait_for_acknowledgments();
                let pause = Duration::from_millis(pause);
                if tokio::time::timeout(pause, acknowledged).await.is_ok() {
                    return;
                }
                send();
            }
        });
        Ok(written)
    }

    /// On the topic, to readers elsewhere.
    fn send_whole(
        &self,
        sample: &Bytes,
        answers: Option<RequestId>,
        when_full: WhenFull,
        window: &mut Window,
    ) -> Result<Written, Error> {
        if self.is_reliable
            && matches!(
                self.writer.wait_for_acknowledgments(Duration::ZERO),
                Ok(true)
            )
        {
            window.all_acknowledged();
        }
        let related = answers.map(|request| SampleIdentity {
            writer_guid: GUID::from_bytes(request.client),
            sequence_number: SequenceNumber::from(request.sequence),
        });
        let options = WriteOptionsBuilder::new()
            .source_timestamp(Timestamp::now())
            .related_sample_identity_opt(related)
            .build();
        let write = || {
            self.writer
                .write_with_options(sample.clone(), options.clone())
        };
        let (mut written, mut left) = (write(), 0);
        if when_full == WhenFull::DropOldest
            && matches!(written, Err(WriteError::WouldBlock { .. }))
        {
            // a reader that is new counts as one that lacks everything
            left = self.leave_behind(window.move_on());
            written = write();
        }
        match written {
            Ok(identity) => {
                let number = identity.sequence_number.into();
                let release = window.wrote(number, sample.len());
                let dropped = match release {
                    Some(release) if self.is_reliable && when_full == WhenFull::DropOldest => {
                        self.leave_behind(release)
                    }
                    _ => 0,
                };
                let dropped = dropped + left;
                Ok(Written::Sent { number, dropped })
            }
            Err(WriteError::WouldBlock { .. }) => Ok(Written::WindowFull),
            Err(error) => Err(Error::middleware(format!("publish {}", self.topic), error)),
        }
    }

    /// Gives up the oldest samples for the readers that do not have them; how many.
    fn leave_behind(&self, Release { number, dropped }: Release) -> u64 {
        let id = self.id();
        let readers = self.shared.matched(&id);
        self.shared.wire.acknowledge(&id, number + 1, readers);
        dropped
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
        let qos = endpoint.qos;
        let this = Self {
            core: Arc::new(WriterCore {
                writer: Arc::new(writer),
                topic: endpoint.name.clone(),
                keep: Keep::of(endpoint).filter(|_| is_of_first),
                is_topic: endpoint.channel == Channel::Topic,
                is_reliable: qos.reliability == Reliability::Reliable,
                is_latched: qos.durability == Durability::TransientLocal,
                sent: Mutex::new(Sent {
                    window: Window::new(qos.depth),
                    here: 0,
                    last: None,
                }),
                shared: Arc::clone(shared),
                runtime: runtime.clone(),
            }),
            waiting: WaitingRoom::default(),
        };
        shared.local.add_writer(this.id(), endpoint);
        shared.nodes.add_endpoint(this.id(), node, endpoint, true);
        shared.changed();
        this
    }

    /// Has an answer sent when its client is connected; false where too many wait already.
    fn hold(&self, payload: &Payload, request: RequestId) -> bool {
        let Some(place) = self.waiting.enter() else {
            return false;
        };
        let (core, id) = (Arc::downgrade(&self.core), self.id());
        let (shared, payload) = (Arc::clone(&self.core.shared), payload.clone());
        let failure = Arc::clone(&shared.failure);
        failure.watch(&self.core.runtime, "answers", async move {
            let _place = place;
            let is_reached = shared.reached(&id, &request.client).await;
            let Some(core) = core.upgrade() else { return };
            let topic = &core.topic;
            if !is_reached {
                tracing::warn!("{topic}: a call is not answered: its client is unreachable");
                return;
            }
            match core.send(&payload, Some(request), WhenFull::DropOldest) {
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

impl DdsWriter {
    /// Keeps what is on the wire until the readers have had time to hand the last sample over.
    fn stay(&self) {
        let Some(last) = lock(&self.core.sent).last else {
            return;
        };
        let until = last + HAND_OVER;
        if until <= Instant::now() {
            return;
        }
        let (core, shared) = (Arc::clone(&self.core), &self.core.shared);
        shared.stay_until(until);
        shared
            .failure
            .watch(&self.core.runtime, "leaving writers", async move {
                tokio::time::sleep_until(until.into()).await;
                drop(core);
            });
    }
}

impl Writer for DdsWriter {
    fn id(&self) -> EndpointId {
        self.core.id()
    }

    fn audience(&self) -> Audience {
        Audience {
            here: self.core.shared.local.matched(&self.id()) > 0,
            elsewhere: self.core.is_latched || self.core.is_heard_elsewhere(),
        }
    }

    fn write(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        when_full: WhenFull,
    ) -> Result<Written, Error> {
        if let Payload::Cdr(sample) = payload {
            self.core.check(sample)?;
        }
        if let Some(request) = answers
            && !self.core.shared.reaches(&self.id(), &request.client)
            && self.hold(payload, request)
        {
            return Ok(Written::Held);
        }
        self.core.send(payload, answers, when_full)
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
        let readers = self.core.shared.matched(&self.id());
        self.core.shared.forget(&self.id());
        // other implementations keep what they have acknowledged
        if self.core.is_reliable && !readers.iter().all(|reader| is_foreign(&self.id(), reader)) {
            self.stay();
        }
    }
}
