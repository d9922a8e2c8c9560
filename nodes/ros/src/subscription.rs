//! Subscriptions, typed and raw.

mod further_reader;
mod gaps;
mod known_publishers;

pub(crate) use further_reader::{FurtherReader, PublisherKind};
pub use gaps::Gaps;
use known_publishers::KnownPublishers;

use crate::{
    Clock, Diagnostics, Durability, Reliability, Shutdown,
    backend::{Backend, Channel, EndpointId, Reader, Sample, Sink},
    lifecycle::{Gate, GatedEndpoint},
    mailbox::Mailbox,
    payload::Payload,
};
use bytes::Bytes;
use std::{
    collections::{BTreeMap, BTreeSet},
    marker::PhantomData,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};
use wm_msgs::{Message, builtin_interfaces::Time, cdr::CdrError};

/// A message and its time of arrival.
#[derive(Clone, Debug, PartialEq)]
pub struct Received<M> {
    /// The message.
    pub message: M,
    /// Its time of arrival (node clock).
    pub received: Time,
    /// Its time of arrival, by a monotonic clock.
    pub at: Instant,
    /// Its publisher.
    pub publisher: PublisherId,
}

/// A publisher in the whole graph: its DDS GUID.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PublisherId(pub [u8; 16]);

impl<M> Received<M> {
    /// Replaces the message by the result of `f`.
    pub fn map<N>(self, f: impl FnOnce(M) -> N) -> Received<N> {
        Received {
            message: f(self.message),
            received: self.received,
            at: self.at,
            publisher: self.publisher,
        }
    }
}

impl<M: Clone> Received<Arc<M>> {
    fn into_owned(self) -> Received<M> {
        self.map(Arc::unwrap_or_clone)
    }
}

/// The receiving end of a topic of any type: CDR bytes with their 4-byte header, unchanged.
///
/// At most `depth` samples (of its QoS) wait to be read; policy DropOldest.
pub struct RawSubscription {
    intake: Arc<Intake>,
    reader: Box<dyn Reader>,
    backend: Arc<dyn Backend>,
    shutdown: Shutdown,
    type_name: String,
    /// Readers for publishers that `reader` does not serve.
    further: Vec<FurtherReader>,
}

/// Reads a message from a payload.
type Read<T> = fn(Payload) -> Result<T, CdrError>;

/// State shared by the receiving thread and the reader of a subscription.
pub(crate) struct Intake {
    topic: String,
    mailbox: Mailbox<Received<Payload>>,
    undecodable: AtomicU64,
    lost: AtomicU64,
    gaps: Mutex<Gaps<EndpointId>>,
    diagnostics: Diagnostics,
    clock: Clock,
    /// The gate of a managed node.
    gate: Option<Gate>,
    /// The newest sample of each latching publisher, for the next activation of a managed node.
    latched: Mutex<BTreeMap<EndpointId, Received<Payload>>>,
}

/// The most remembered latching publishers: far more than a topic has.
const MAX_LATCHING: usize = 16;

impl Intake {
    pub(crate) fn new(
        topic: String,
        depth: usize,
        diagnostics: Diagnostics,
        clock: Clock,
        gate: Option<Gate>,
    ) -> Arc<Self> {
        let (undecodable, lost) = (AtomicU64::new(0), AtomicU64::new(0));
        let intake = Arc::new(Self {
            topic,
            mailbox: Mailbox::new(depth),
            undecodable,
            lost,
            gaps: Mutex::default(),
            diagnostics,
            clock,
            gate,
            latched: Mutex::default(),
        });
        if let Some(gate) = &intake.gate {
            let gated: Arc<dyn GatedEndpoint> = intake.clone();
            gate.add(Arc::downgrade(&gated));
        }
        intake
    }

    /// The sink that the middleware calls for each sample.
    pub(crate) fn sink(self: &Arc<Self>) -> Sink {
        let intake = Arc::clone(self);
        Box::new(move |sample| match sample {
            Ok(sample) => intake.take(sample),
            Err(reason) => intake.refuse(&reason),
        })
    }

    /// As [`sink`](Self::sink), for one of two readers of the same publishers: skips samples that the other has
    /// received, and older ones.
    pub(crate) fn sink_of_two(self: &Arc<Self>) -> Sink {
        let intake = Arc::clone(self);
        Box::new(move |sample| match sample {
            Ok(sample) => {
                // Locked until the sample is queued: two threads may serve the readers, and a duplicate or late sample
                // would count as a drop.
                let mut gaps = intake.gaps();
                if let Some(lost) = gaps.after_new(sample.writer, sample.sequence) {
                    intake.keep(sample, lost);
                }
            }
            Err(reason) => intake.refuse(&reason),
        })
    }

    /// As [`sink_of_two`](Self::sink_of_two), for the reader that serves best-effort publishers. It is connected to
    /// reliable publishers too, but may miss their samples; the other reader gets these late, so they are left to it.
    pub(crate) fn sink_of_best_effort(self: &Arc<Self>, backend: &Arc<dyn Backend>) -> Sink {
        let mut sink = self.sink_of_two();
        let mut reliable = KnownPublishers::new(backend, |publisher| {
            publisher.qos.reliability == Reliability::Reliable
        });
        Box::new(move |sample| {
            if let Ok(sample) = &sample
                && reliable.get(&sample.writer) == Some(true)
            {
                return;
            }
            sink(sample);
        })
    }

    /// As [`sink_of_two`](Self::sink_of_two), for the reader of latching publishers only. On activation, a managed node
    /// receives the latched samples, as a new subscription would.
    pub(crate) fn sink_of_latched(self: &Arc<Self>) -> Sink {
        let intake = Arc::clone(self);
        let mut sink = self.sink_of_two();
        Box::new(move |sample| {
            if let Ok(sample) = &sample
                && intake.gate.is_some()
            {
                intake.remember(sample);
            }
            sink(sample);
        })
    }

    /// As [`sink_of_latched`](Self::sink_of_latched), for the only reader of a subscription: samples of volatile
    /// publishers are not repeated on activation.
    pub(crate) fn sink_of_any(self: &Arc<Self>, backend: &Arc<dyn Backend>) -> Sink {
        let (mut latched, mut volatile) = (self.sink_of_latched(), self.sink_of_two());
        let mut latching = KnownPublishers::new(backend, |publisher| {
            publisher.qos.durability == Durability::TransientLocal
        });
        Box::new(move |sample| match &sample {
            // a latched sample may arrive before its publisher is discovered
            Ok(known) if latching.get(&known.writer) == Some(false) => volatile(sample),
            _ => latched(sample),
        })
    }

    fn remember(&self, sample: &Sample) {
        let received = self.received(sample.writer, sample.payload.clone());
        let mut latched = self.latched();
        if latched.len() >= MAX_LATCHING && !latched.contains_key(&sample.writer) {
            latched.pop_first();
        }
        latched.insert(sample.writer, received);
    }

    /// No invariant spans the lock.
    fn latched(&self) -> std::sync::MutexGuard<'_, BTreeMap<EndpointId, Received<Payload>>> {
        self.latched.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// No invariant spans the lock.
    fn gaps(&self) -> std::sync::MutexGuard<'_, Gaps<EndpointId>> {
        self.gaps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, sample: Sample) {
        let lost = self.gaps().after(sample.writer, sample.sequence);
        self.keep(sample, lost);
    }

    fn keep(&self, sample: Sample, lost: u64) {
        // samples for an inactive node are no loss
        if self.gate.as_ref().is_some_and(|gate| !gate.is_open()) {
            return;
        }
        if lost > 0 {
            self.lost.fetch_add(lost, Ordering::Relaxed);
            self.diagnostics
                .count_drops(&format!("{}: lost in transport", self.topic), lost);
        }
        self.diagnostics.received(&self.topic);
        let received = self.received(sample.writer, sample.payload);
        if !self.mailbox.push(received) {
            self.diagnostics
                .count_drop(&format!("{}: queue full", self.topic));
        }
    }

    fn received(&self, writer: EndpointId, message: Payload) -> Received<Payload> {
        Received {
            message,
            received: self.clock.now(),
            at: Instant::now(),
            publisher: PublisherId(writer),
        }
    }

    /// The message that `read` decodes; `None`, counted, if it fails.
    fn read<T>(&self, sample: Received<Payload>, read: Read<T>) -> Option<Received<T>> {
        let mut refused = None;
        let read = sample.map(|payload| read(payload).map_err(|error| refused = Some(error)).ok());
        if let Some(error) = refused {
            self.refuse(&error.to_string());
        }
        let Received {
            message,
            received,
            at,
            publisher,
        } = read;
        message.map(|message| Received {
            message,
            received,
            at,
            publisher,
        })
    }

    /// Counts an undecodable sample, and reports the first.
    fn refuse(&self, reason: &str) {
        if self.undecodable.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!(
                "{}: a sample is skipped, as will be others like it: {reason}",
                self.topic
            );
        }
        self.diagnostics
            .count_drop(&format!("{}: undecodable", self.topic));
    }
}

impl GatedEndpoint for Intake {
    fn opened(&self, backend: &dyn Backend) {
        self.mailbox.clear();
        let mut latched = self.latched();
        if latched.is_empty() {
            return;
        }
        let seen = backend.seen();
        latched.retain(|writer, _| seen.iter().any(|seen| seen.id == *writer));
        for received in latched.values() {
            self.mailbox.push(received.clone());
        }
    }

    fn closed(&self) {
        self.mailbox.clear();
    }
}

impl RawSubscription {
    pub(crate) fn new(
        intake: Arc<Intake>,
        reader: Box<dyn Reader>,
        backend: Arc<dyn Backend>,
        shutdown: Shutdown,
        type_name: String,
        further: Vec<FurtherReader>,
    ) -> Self {
        intake
            .diagnostics
            .add_endpoint(reader.id(), &intake.topic, false);
        Self {
            intake,
            reader,
            backend,
            shutdown,
            type_name,
            further,
        }
    }

    /// Waits for a sample; `None` once the context is shut down. Cancel safe.
    pub async fn recv(&mut self) -> Option<Received<Bytes>> {
        self.recv_as(Payload::into_cdr).await
    }

    /// A waiting sample, if any; also after the shutdown, to read the rest of the queue.
    pub fn try_recv(&mut self) -> Option<Received<Bytes>> {
        self.try_recv_as(Payload::into_cdr)
    }

    async fn recv_as<T>(&mut self, read: Read<T>) -> Option<Received<T>> {
        loop {
            let sample = tokio::select! {
                biased;
                () = self.shutdown.wait() => None,
                sample = self.intake.mailbox.pop() => sample,
            };
            if let Some(received) = self.intake.read(sample?, read) {
                return Some(received);
            }
        }
    }

    fn try_recv_as<T>(&mut self, read: Read<T>) -> Option<Received<T>> {
        loop {
            let sample = self.intake.mailbox.try_pop()?;
            if let Some(received) = self.intake.read(sample, read) {
                return Some(received);
            }
        }
    }

    /// The topic's absolute name.
    pub fn topic(&self) -> &str {
        &self.intake.topic
    }

    /// Number of samples dropped because they were not read in time.
    pub fn dropped(&self) -> u64 {
        self.intake.mailbox.dropped()
    }

    /// Number of samples that never arrived, by gaps in their publishers' sequence numbers.
    pub fn lost(&self) -> u64 {
        self.intake.lost.load(Ordering::Relaxed)
    }

    /// Number of samples skipped because they could not be decoded.
    pub fn undecodable(&self) -> u64 {
        self.intake.undecodable.load(Ordering::Relaxed)
    }

    /// The number of connected publishers.
    pub fn publishers(&self) -> usize {
        self.backend.matched(&self.reader.id())
    }

    /// The publishers in the graph that have this topic and type.
    pub fn matching_publishers(&self) -> BTreeSet<PublisherId> {
        let seen = self.backend.seen().into_iter();
        let matching = seen.filter(|seen| {
            seen.is_writer
                && seen.channel == Channel::Topic
                && seen.name == self.intake.topic
                && seen.type_name == self.type_name
        });
        matching.map(|seen| PublisherId(seen.id)).collect()
    }

    /// Why other publishers of the topic are not connected, as text: their type or quality of service.
    pub fn mismatches(&self) -> Vec<String> {
        let mut mismatches = self.backend.mismatches(&self.reader.id());
        let failures = self.further.iter().filter_map(FurtherReader::failure);
        mismatches.extend(failures.map(str::to_owned));
        mismatches
    }

    /// Waits until at least `number` publishers are connected.
    pub async fn wait_for_publishers(&self, number: usize) {
        let mut changes = self.backend.changes();
        while self.publishers() < number {
            if changes.changed().await.is_err() {
                return;
            }
        }
    }
}

impl Drop for RawSubscription {
    fn drop(&mut self) {
        self.intake.mailbox.close();
        self.intake.diagnostics.remove_endpoint(&self.reader.id());
    }
}

/// The receiving end of a topic of messages `M`. At most `depth` messages of its QoS wait to be read; policy
/// DropOldest. An undecodable sample is counted, reported and skipped.
pub struct Subscription<M> {
    raw: RawSubscription,
    of: PhantomData<fn() -> M>,
}

impl<M: Message> Subscription<M> {
    pub(crate) fn new(raw: RawSubscription) -> Self {
        Self {
            raw,
            of: PhantomData,
        }
    }

    /// Waits for a message; `None` once the context is shut down. Cancel safe. A message of this context that is still
    /// shared is copied; [`recv_shared`](Self::recv_shared) saves the copy.
    pub async fn recv(&mut self) -> Option<Received<M>> {
        self.recv_shared().await.map(Received::into_owned)
    }

    /// As [`recv`](Self::recv), without a copy: a message of this context is the published `Arc`.
    pub async fn recv_shared(&mut self) -> Option<Received<Arc<M>>> {
        self.raw.recv_as(Payload::into_message).await
    }

    /// A waiting message, if any; also after the shutdown, to read the rest of the queue.
    pub fn try_recv(&mut self) -> Option<Received<M>> {
        let received = self.raw.try_recv_as(Payload::into_message);
        received.map(Received::into_owned)
    }

    /// The topic's absolute name.
    pub fn topic(&self) -> &str {
        self.raw.topic()
    }

    /// Number of messages dropped because they were not read in time.
    pub fn dropped(&self) -> u64 {
        self.raw.dropped()
    }

    /// Number of messages that never arrived, by gaps in their publishers' sequence numbers.
    pub fn lost(&self) -> u64 {
        self.raw.lost()
    }

    /// Number of samples skipped because they could not be decoded.
    pub fn undecodable(&self) -> u64 {
        self.raw.undecodable()
    }

    /// The number of connected publishers.
    pub fn publishers(&self) -> usize {
        self.raw.publishers()
    }

    /// The publishers in the graph that have this topic and type.
    pub fn matching_publishers(&self) -> BTreeSet<PublisherId> {
        self.raw.matching_publishers()
    }

    /// Why other publishers of the topic are not connected, as text: their type or quality of service.
    pub fn mismatches(&self) -> Vec<String> {
        self.raw.mismatches()
    }

    /// Waits until at least `number` publishers are connected.
    pub async fn wait_for_publishers(&self, number: usize) {
        self.raw.wait_for_publishers(number).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{cdr, std_msgs};

    fn sample(sequence: i64, bytes: Vec<u8>) -> Result<Sample, String> {
        Ok(Sample {
            payload: Payload::Cdr(bytes.into()),
            writer: [1; 16],
            sequence,
            request: None,
        })
    }

    fn report_of(diagnostics: &Diagnostics) -> wm_msgs::diagnostic_msgs::DiagnosticStatus {
        struct Alone;

        impl crate::diagnostics::Graph for Alone {
            fn matched(&self, _: &crate::backend::EndpointId) -> usize {
                0
            }

            fn foreign(&self, _: &crate::backend::EndpointId) -> usize {
                0
            }

            fn mismatches(&self, _: &crate::backend::EndpointId) -> Vec<String> {
                Vec::new()
            }

            fn published_alike(&self, _: &crate::backend::EndpointId) -> BTreeSet<String> {
                BTreeSet::new()
            }
        }
        let now = std::time::Instant::now();
        diagnostics.report(now, &Alone).swap_remove(0)
    }

    /// A subscription to goals has two readers: one for latched samples, one for new ones.
    #[test]
    fn of_two_readers_each_sample_is_taken_once_whoever_is_first() {
        const SAMPLES: i64 = 20_000;
        let (diagnostics, depth) = (Diagnostics::new("/wm/test"), 40_000);
        let intake = Intake::new("/wm/goal".into(), depth, diagnostics, Clock::new(), None);
        let together = std::sync::Barrier::new(2);
        std::thread::scope(|threads| {
            for _ in 0..2 {
                let (mut sink, together) = (intake.sink_of_two(), &together);
                threads.spawn(move || {
                    together.wait();
                    for sequence in 1..=SAMPLES {
                        sink(sample(sequence, Vec::new()));
                    }
                });
            }
        });
        let taken = std::iter::from_fn(|| intake.mailbox.try_pop()).count();
        let lost = intake.lost.load(Ordering::Relaxed);
        // Samples that one reader delivers late are skipped: neither duplicated nor counted as lost.
        assert_eq!((taken as u64, lost), (SAMPLES as u64, 0));
    }

    #[test]
    fn lost_dropped_and_undecodable_samples_are_counted() {
        let diagnostics = Diagnostics::new("/wm/test");
        let intake = Intake::new(
            "/wm/text".into(),
            2,
            diagnostics.clone(),
            Clock::new(),
            None,
        );
        let mut sink = intake.sink();
        let text = |text: &str| cdr::to_bytes(&std_msgs::String { data: text.into() }).unwrap();
        sink(sample(1, text("dropped")));
        sink(sample(2, vec![0, 1, 0, 0, 9, 9, 9, 9]));
        sink(sample(7, text("kept")));
        sink(Err("an unknown representation".into()));
        let report = report_of(&diagnostics);
        assert!(
            report
                .message
                .contains("dropped 4: /wm/text: lost in transport"),
            "{}",
            report.message
        );
        assert!(
            report.message.contains("dropped 1: /wm/text: queue full"),
            "{}",
            report.message
        );

        let mailbox = &intake.mailbox;
        let mut decoded = Vec::new();
        while let Some(received) = mailbox.try_pop() {
            match received.message.into_message::<std_msgs::String>() {
                Ok(message) => decoded.push(message.data.clone()),
                Err(error) => intake.refuse(&error.to_string()),
            }
        }
        assert_eq!(decoded, ["kept"]);
        assert_eq!(intake.undecodable.load(Ordering::Relaxed), 2);
        assert_eq!(mailbox.dropped(), 1);
    }
}
