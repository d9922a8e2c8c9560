//! DDS writers.

use super::{
    codec::HEADER_LEN,
    identity::is_foreign,
    names::{dds_name, dds_type},
    own_endpoints::OwnEndpoint,
    shared::Shared,
    workarounds::{
        latched::Stamps,
        line::{LULL, Line, Maker, Patience, RETIREMENT},
        one_way::AcknowledgmentWait,
        parts::{
            message::LARGEST,
            outbox::{OfferOutcome, Retention},
        },
        resend::{LargeSample, RepeatState},
        rtps::LARGEST_ANSWER,
        wire::Answer,
    },
};
use crate::{
    Durability, Error, Reliability,
    backend::{Audience, Channel, Endpoint, EndpointId, RequestId, WhenFull, WriteOutcome, Writer},
    clock::system_nanos,
    dds::identity::participant_of,
    lock::lock,
    payload::Payload,
};
use bytes::Bytes;
use futures::future::BoxFuture;
use rustdds::{
    Timestamp,
    dds::result::{CreateResult, WriteError},
};
use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, Weak,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};
use tokio::{runtime::Handle, sync::Semaphore};

/// Pauses until an unacknowledged response is sent again \[ms\].
const REPEAT_ANSWER: [u64; 5] = [50, 100, 200, 400, 800];

/// How long a writer stays after its last sample. When a writer leaves, rustdds 0.15.1 forgets samples that its readers
/// have acknowledged but not handed over (`TopicCache::forget_reliable_writer`). A busy receiver would lose the last
/// response of a service and the last messages of a node.
pub(super) const HAND_OVER: Duration = Duration::from_millis(250);

/// Responses of one server that wait at once.
const MOST_HELD: usize = 64;

pub(super) struct DdsWriter {
    core: Arc<WriterCore>,
    /// Limits the responses that wait for their client.
    held: Arc<Semaphore>,
}

/// A reader without acknowledgements for this long does not wait for fragments.
const STUCK: Duration = Duration::from_secs(2);

/// How long a retired DDS writer waits for the readers of large messages.
const PARTS_RETIREMENT: Duration = Duration::from_secs(10);

/// The part of a writer that waiting responses share.
struct WriterCore {
    /// Its first DDS writer, which identifies the publisher in this process.
    id: EndpointId,
    this: Weak<Self>,
    maker: Maker,
    endpoint: Endpoint,
    node: String,
    /// What it keeps of messages in parts; `None` if it sends none in parts.
    keep: Option<Retention>,
    is_topic: bool,
    is_reliable: bool,
    is_latched: bool,
    repeats: RepeatState,
    /// Held while a sample is sent, so that all readers receive the same order.
    sent: Mutex<SendState>,
    /// Samples of retired DDS writers that some reader never took, until reported.
    given_up: AtomicU64,
    shared: Arc<Shared>,
    runtime: Handle,
}

struct SendState {
    /// The current DDS writer.
    line: Line,
    /// Takes over when the readers of `line` are connected to it.
    successor: Option<Line>,
    patience: Patience,
    wait: AcknowledgmentWait,
    /// The times of a latched topic's samples.
    stamps: Stamps,
    /// The last samples with their times, for late readers of the next DDS writer.
    history: VecDeque<(Bytes, Timestamp)>,
    /// Samples delivered within the process. Its readers miss nothing, whereas samples without a remote reader are not
    /// sent.
    here: i64,
    /// When the last sample was sent to other processes.
    last: Option<Instant>,
}

impl WriterCore {
    /// Whether other processes have readers, or may have late ones.
    fn has_remote_readers(&self) -> bool {
        let current = || self.shared.lines.current(&self.id);
        let is_matched = || lock(&self.shared.matches).contains_key(&current());
        !self.shared.is_alone && (self.is_latched || is_matched())
    }

    fn send(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        when_full: WhenFull,
    ) -> Result<WriteOutcome, Error> {
        let mut sent = lock(&self.sent);
        // the number on the wire identifies a call
        let written = if !self.is_topic || self.has_remote_readers() {
            let sample = payload.cdr()?;
            sent.last = Some(Instant::now());
            self.send_elsewhere(&sample, answers, when_full, &mut sent)?
        } else {
            WriteOutcome::Sent {
                number: sent.line.window.last(),
                dropped: 0,
            }
        };
        let WriteOutcome::Sent { number, .. } = written else {
            return Ok(written);
        };
        sent.here += 1;
        let number = if self.is_topic { sent.here } else { number };
        let local = &self.shared.local;
        local.deliver(self.id, number, payload, answers);
        Ok(written)
    }

    fn check(&self, sample: &Bytes) -> Result<(), Error> {
        let header = sample.get(..HEADER_LEN);
        if let Some([0x00, 0x01, ..]) = header {
            return Ok(());
        }
        let representation = header.and_then(|header| Some(*header.first_chunk::<2>()?));
        Err(Error::Representation {
            topic: self.endpoint.name.clone(),
            representation: representation.map_or(0xffff, u16::from_be_bytes),
        })
    }

    fn send_elsewhere(
        &self,
        sample: &Bytes,
        answers: Option<RequestId>,
        when_full: WhenFull,
        sent: &mut SendState,
    ) -> Result<WriteOutcome, Error> {
        if self.shared.is_alone {
            // without remote readers nothing is acknowledged
            let number = sent.line.window.last() + 1;
            sent.line.window.wrote(number, 0);
            sent.line.window.acknowledged(number);
            return Ok(WriteOutcome::Sent { number, dropped: 0 });
        }
        if let Some(keep) = self.keep
            && self.shared.parts.takes(&sent.line.id(), sample.len())
        {
            return self.send_in_parts(sample, keep, when_full, sent);
        }
        match answers {
            Some(request) => self.send_answer(sample, request, when_full, sent),
            None => self.send_whole(sample, None, when_full, sent),
        }
    }

    fn send_in_parts(
        &self,
        sample: &Bytes,
        keep: Retention,
        when_full: WhenFull,
        sent: &mut SendState,
    ) -> Result<WriteOutcome, Error> {
        let (id, parts) = (sent.line.id(), &self.shared.parts);
        self.check_len(sample.len(), LARGEST)?;
        parts.open(id, keep, sent.line.window.last());
        if when_full == WhenFull::Refuse && parts.is_full(&id) {
            return Ok(WriteOutcome::WindowFull);
        }
        let (peers, has_others) = self.shared.readers_in_parts(&id);
        let (copy, dropped_elsewhere) = match has_others {
            false => (0, 0),
            true => match self.send_whole(sample, None, when_full, sent)? {
                WriteOutcome::Sent { number, dropped } => (number, dropped),
                not_sent => return Ok(not_sent),
            },
        };
        // the copy may have been sent by the next DDS writer
        let id = sent.line.id();
        let offered = self.shared.offer(&id, sample, copy, peers);
        let Some(OfferOutcome { number, dropped }) = offered else {
            return Err(Error::ShutDown(self.endpoint.name.clone()));
        };
        Ok(WriteOutcome::Sent {
            number,
            dropped: dropped + dropped_elsewhere,
        })
    }

    fn check_len(&self, len: usize, largest: usize) -> Result<(), Error> {
        if len <= largest {
            return Ok(());
        }
        let topic = self.endpoint.name.clone();
        Err(Error::MessageTooLarge {
            topic,
            len,
            largest,
        })
    }

    /// Sends a response; not through rustdds if it would corrupt it.
    fn send_answer(
        &self,
        sample: &Bytes,
        request: RequestId,
        when_full: WhenFull,
        sent: &mut SendState,
    ) -> Result<WriteOutcome, Error> {
        let (id, shared) = (self.id, &self.shared);
        let clients = shared.matched(&id);
        if sample.len() <= shared.largest_answer(&id, &clients) {
            return self.send_whole(sample, Some(request), when_full, sent);
        }
        if sample.len() > LARGEST_ANSWER {
            return Err(Error::AnswerTooLarge {
                service: self.endpoint.name.clone(),
                len: sample.len(),
                largest: LARGEST_ANSWER,
            });
        }
        let answer = Answer {
            writer: id,
            number: sent.line.window.last() + 1,
            request,
            nanos: system_nanos(),
            sample: sample.clone(),
        };
        // to all clients: each client of a service takes all responses, and waits for a missing one
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
        let written = self.send_whole(sample, Some(request), when_full, sent)?;
        // a datagram may be lost
        let writer = Arc::downgrade(sent.line.writer());
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

    /// Sends a sample on the topic to other processes.
    fn send_whole(
        &self,
        sample: &Bytes,
        answers: Option<RequestId>,
        when_full: WhenFull,
        sent: &mut SendState,
    ) -> Result<WriteOutcome, Error> {
        if self.is_reliable && !self.has_room(when_full, sent) {
            return Ok(WriteOutcome::WindowFull);
        }
        let mut now = Timestamp::now();
        if self.is_latched {
            now = sent.stamps.next(now);
        }
        let large = match self.is_topic && self.is_reliable && !sent.wait.is_longer_than(STUCK) {
            true => LargeSample::of(sent.line.id(), sent.line.window.last() + 1, now, sample),
            false => None,
        };
        if let Some(large) = &large {
            self.shared.send_ahead(large, &self.repeats);
        }
        let number = match sent.line.write(sample, answers, now) {
            Ok(number) => number,
            Err(WriteError::WouldBlock { .. }) => return Ok(WriteOutcome::WindowFull),
            Err(error) => {
                let action = format!("publish {}", self.endpoint.name);
                return Err(Error::middleware(action, error));
            }
        };
        if !self.is_reliable {
            sent.line.window.acknowledged(number);
        } else if let Some(large) = large {
            let writer = Arc::downgrade(sent.line.writer());
            self.shared.resend(writer, large, &self.repeats);
        }
        if self.is_latched {
            sent.history.push_back((sample.clone(), now));
            while sent.history.len() > self.endpoint.qos.depth.max(1) {
                sent.history.pop_front();
            }
        }
        let dropped = self.given_up.swap(0, Ordering::Relaxed);
        Ok(WriteOutcome::Sent { number, dropped })
    }

    /// Checks for slow readers, and lets the next DDS writer take over if possible. Returns whether a sample may be
    /// sent.
    fn has_room(&self, when_full: WhenFull, sent: &mut SendState) -> bool {
        let is_acknowledged = sent.line.update();
        let is_waiting = sent.line.window.unacknowledged() > 0;
        let looked = [is_acknowledged, is_waiting];
        let line = sent.line.id();
        if self.shared.one_way.record(&line, &mut sent.wait, looked) {
            self.shared.renew(&line);
        }
        // the DDS writer identifies a call
        if !self.is_topic {
            return !sent.line.window.is_full();
        }
        if sent.line.window.unacknowledged() == 0 {
            sent.patience.reset();
            // the slow reader has caught up or left
            if let Some(successor) = sent.successor.take() {
                self.shared.forget_line(&successor.id());
            }
        }
        if !sent.line.window.is_behind(sent.patience.samples()) {
            return true;
        }
        if when_full == WhenFull::Refuse {
            return false;
        }
        let is_stuck = sent.wait.is_longer_than(LULL);
        match sent.successor.take() {
            None if !is_stuck || self.shared.catch_up.is_pending() => {}
            None => match self.start() {
                Ok(line) => sent.successor = Some(line),
                Err(error) => tracing::debug!("{}: {error}", self.endpoint.name),
            },
            Some(successor) if self.shared.has_readers_of(&successor.id(), &sent.line.id()) => {
                self.hand_on(sent, successor);
            }
            some => sent.successor = some,
        }
        !sent.line.window.is_full()
    }

    /// Makes the next DDS writer.
    fn start(&self) -> CreateResult<Line> {
        let line = Line::new(self.maker.make()?);
        self.register(line.id());
        Ok(line)
    }

    fn register(&self, line: EndpointId) {
        let (shared, name) = (&self.shared, dds_name(&self.endpoint));
        shared.lines.add(self.id, line);
        let own = OwnEndpoint {
            topic: name,
            type_name: dds_type(&self.endpoint),
            qos: self.maker.qos.clone(),
            is_writer: true,
        };
        shared.own.add(line, own);
        shared
            .nodes
            .add_endpoint(line, &self.node, &self.endpoint, true);
    }

    /// Makes `successor` the current DDS writer.
    fn hand_on(&self, sent: &mut SendState, mut successor: Line) {
        let (old, new) = (sent.line.id(), successor.id());
        for (sample, written) in &sent.history {
            // late readers need them; readers of this suite recognise repetitions by their times
            if let Err(error) = successor.write(sample, None, *written) {
                tracing::debug!("{}: {error}", self.endpoint.name);
            }
        }
        if let Some(keep) = self.keep
            && self.shared.parts.has(&old)
        {
            self.shared.parts.open(new, keep, 0);
        }
        self.shared.lines.set_current(self.id, new);
        sent.patience.grow();
        let retired = std::mem::replace(&mut sent.line, successor);
        let retirement = retire(self.this.clone(), Arc::clone(&self.shared), retired);
        let failure = &self.shared.failure;
        failure.watch(&self.runtime, "retired writers", retirement);
        self.shared.changed();
    }
}

/// Keeps a DDS writer until its readers have had time to take its samples, then drops it.
async fn retire(core: Weak<WriterCore>, shared: Arc<Shared>, mut line: Line) {
    let id = line.id();
    tokio::time::sleep(RETIREMENT).await;
    let settled = shared.parts.acknowledged(&id);
    tokio::time::timeout(PARTS_RETIREMENT, settled).await.ok();
    line.update();
    if let Some(core) = core.upgrade() {
        let given_up = line.window.unacknowledged() as u64;
        core.given_up.fetch_add(given_up, Ordering::Relaxed);
    }
    shared.forget_line(&id);
}

impl DdsWriter {
    pub(super) fn new(
        maker: Maker,
        endpoint: &Endpoint,
        node: &str,
        shared: &Arc<Shared>,
        runtime: &Handle,
    ) -> CreateResult<Self> {
        let line = Line::new(maker.make()?);
        let id = line.id();
        // offers come from the first participant
        let is_of_first = participant_of(&id) == shared.first;
        let qos = endpoint.qos;
        let core = Arc::new_cyclic(|this| WriterCore {
            id,
            this: Weak::clone(this),
            maker,
            endpoint: endpoint.clone(),
            node: node.to_owned(),
            keep: Retention::of(endpoint).filter(|_| is_of_first),
            is_topic: endpoint.channel == Channel::Topic,
            is_reliable: qos.reliability == Reliability::Reliable,
            is_latched: qos.durability == Durability::TransientLocal,
            repeats: RepeatState::default(),
            sent: Mutex::new(SendState {
                line,
                successor: None,
                patience: Patience::default(),
                wait: AcknowledgmentWait::default(),
                stamps: Stamps::new(&id),
                history: VecDeque::new(),
                here: 0,
                last: None,
            }),
            given_up: AtomicU64::new(0),
            shared: Arc::clone(shared),
            runtime: runtime.clone(),
        });
        shared.local.add_writer(id, endpoint);
        core.register(id);
        shared.changed();
        let held = Arc::new(Semaphore::new(MOST_HELD));
        Ok(Self { core, held })
    }

    /// Sends a response when its client is connected; false if too many wait already.
    fn hold(&self, payload: &Payload, request: RequestId) -> bool {
        let Ok(permit) = Arc::clone(&self.held).try_acquire_owned() else {
            return false;
        };
        let (core, id) = (Arc::downgrade(&self.core), self.core.id);
        let (shared, payload) = (Arc::clone(&self.core.shared), payload.clone());
        let failure = Arc::clone(&shared.failure);
        failure.watch(&self.core.runtime, "answers", async move {
            let _permit = permit;
            let is_reached = shared.reached(&id, &request.client).await;
            let Some(core) = core.upgrade() else { return };
            let topic = &core.endpoint.name;
            if !is_reached {
                tracing::warn!("{topic}: a call is not answered: its client is unreachable");
                return;
            }
            match core.send(&payload, Some(request), WhenFull::DropOldest) {
                Ok(WriteOutcome::WindowFull) => {
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
    /// Delays the departure until readers have had time to hand over the last sample.
    fn delay_departure(&self) {
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
        self.core.id
    }

    fn audience(&self) -> Audience {
        Audience {
            here: self.core.shared.local.matched(&self.id()) > 0,
            elsewhere: self.core.is_latched || self.core.has_remote_readers(),
        }
    }

    fn write(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        when_full: WhenFull,
    ) -> Result<WriteOutcome, Error> {
        if let Payload::Cdr(sample) = payload {
            self.core.check(sample)?;
        }
        if let Some(request) = answers
            && !self.core.shared.reaches(&self.id(), &request.client)
            && self.hold(payload, request)
        {
            return Ok(WriteOutcome::Held);
        }
        self.core.send(payload, answers, when_full)
    }

    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>> {
        Box::pin(async move {
            let writer = Arc::clone(lock(&self.core.sent).line.writer());
            let wait = writer.async_wait_for_acknowledgments();
            wait.await.map(drop).map_err(|error| {
                let action = format!("wait for the readers of {}", self.core.endpoint.name);
                Error::middleware(action, error)
            })?;
            let line = self.core.shared.lines.current(&self.core.id);
            self.core.shared.parts.acknowledged(&line).await;
            Ok(())
        })
    }
}

impl Drop for DdsWriter {
    fn drop(&mut self) {
        let (core, shared) = (&self.core, &self.core.shared);
        let (line, successor) = {
            let mut sent = lock(&core.sent);
            (sent.line.id(), sent.successor.take())
        };
        let readers = shared.matched(&line);
        if let Some(successor) = successor {
            shared.forget_line(&successor.id());
        }
        shared.forget_line(&line);
        shared.lines.remove_publisher(&core.id);
        shared.forget(&core.id);
        // other implementations keep acknowledged samples
        if core.is_reliable && !readers.iter().all(|reader| is_foreign(&core.id, reader)) {
            self.delay_departure();
        }
    }
}
