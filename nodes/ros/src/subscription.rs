//! Subscriptions, typed and raw.

mod further_reader;
mod gaps;
mod intake;
mod known_publishers;

pub(crate) use further_reader::{FurtherReader, PublisherKind};
pub use gaps::Gaps;
pub(crate) use intake::Intake;
use intake::Read;

use crate::{
    Shutdown,
    backend::{Backend, Channel, Reader},
    payload::Payload,
};
use bytes::Bytes;
use std::{collections::BTreeSet, marker::PhantomData, sync::Arc, time::Instant};
use wm_msgs::{Message, builtin_interfaces::Time};

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
        self.intake.lost()
    }

    /// Number of samples skipped because they could not be decoded.
    pub fn undecodable(&self) -> u64 {
        self.intake.undecodable()
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
