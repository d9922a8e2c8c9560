//! Publishers, typed and raw.

use crate::{
    Diagnostics, Error, Shutdown,
    backend::{Backend, Writer, Written},
    lifecycle::Gate,
};
use bytes::Bytes;
use std::{
    marker::PhantomData,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};
use wm_msgs::{Message, cdr};

/// Above this size \[byte\] a sample does not reliably reach a stock ROS 2 machine: it arrives as one burst of
/// fragments, which a default receive buffer of 212 kB loses part of.
const SAFE_SAMPLE_BYTES: usize = 98_000;

/// The sending end of a topic, for messages of any type as CDR bytes. A managed node that is not active sends nothing.
#[derive(Clone)]
pub struct RawPublisher {
    inner: Arc<Inner>,
}

struct Inner {
    topic: String,
    writer: Box<dyn Writer>,
    backend: Arc<dyn Backend>,
    diagnostics: Diagnostics,
    shutdown: Shutdown,
    dropped: AtomicU64,
    has_warned_of_size: AtomicBool,
    /// Of a managed node.
    gate: Option<Gate>,
}

impl RawPublisher {
    pub(crate) fn new(
        topic: String,
        writer: Box<dyn Writer>,
        backend: Arc<dyn Backend>,
        diagnostics: Diagnostics,
        shutdown: Shutdown,
        gate: Option<Gate>,
    ) -> Self {
        let (dropped, has_warned_of_size) = (AtomicU64::new(0), AtomicBool::new(false));
        diagnostics.add_endpoint(writer.id(), &topic, true);
        Self {
            inner: Arc::new(Inner {
                topic,
                writer,
                backend,
                diagnostics,
                shutdown,
                dropped,
                has_warned_of_size,
                gate,
            }),
        }
    }

    /// Publishes a sample: little-endian CDR with its 4-byte header. Never blocks. Policy DropNewest: where a
    /// reliable reader has fallen so far behind that the window is full, the sample is dropped and counted.
    ///
    /// # Errors
    /// The bytes are not little-endian CDR, or the middleware failed.
    pub fn publish(&self, sample: Bytes) -> Result<(), Error> {
        let inner = &*self.inner;
        if self.is_closed() {
            return Ok(());
        }
        self.warn_of_size(sample.len());
        match inner.writer.write(&sample, None)? {
            Written::Sent(_) | Written::Held => inner.diagnostics.sent(&inner.topic),
            Written::WindowFull => self.drop_one(),
        }
        Ok(())
    }

    /// Whether the node is managed and not active.
    fn is_closed(&self) -> bool {
        self.inner.gate.as_ref().is_some_and(|gate| !gate.is_open())
    }

    fn drop_one(&self) {
        let inner = &*self.inner;
        if inner.dropped.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!(
                "{}: a reader has fallen behind, samples are dropped",
                inner.topic
            );
        }
        inner
            .diagnostics
            .count_drop(&format!("{}: a reader is behind", inner.topic));
    }

    /// Publishes a sample, waiting until readers that have fallen behind have caught up. Policy Block. A shutdown
    /// ends the wait; the sample is then dropped and counted.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    pub async fn publish_when_ready(&self, sample: Bytes) -> Result<(), Error> {
        let inner = &*self.inner;
        if self.is_closed() {
            return Ok(());
        }
        self.warn_of_size(sample.len());
        while inner.writer.write(&sample, None)? == Written::WindowFull {
            tokio::select! {
                acknowledged = inner.writer.acknowledged() => acknowledged?,
                () = inner.shutdown.wait() => {
                    self.drop_one();
                    return Ok(());
                }
            }
        }
        inner.diagnostics.sent(&inner.topic);
        Ok(())
    }

    fn warn_of_size(&self, len: usize) {
        if len <= SAFE_SAMPLE_BYTES {
            return;
        }
        let inner = &*self.inner;
        let id = inner.writer.id();
        inner.diagnostics.oversized(id, len);
        if inner.backend.foreign(&id) > 0 && !inner.has_warned_of_size.swap(true, Ordering::Relaxed)
        {
            tracing::warn!(
                "{}: a message of {len} bytes may not reach subscribers of another DDS implementation (up to \
                 {SAFE_SAMPLE_BYTES} do) unless net.core.rmem_default and rmem_max are 4194304 on their machine",
                inner.topic
            );
        }
    }

    /// The topic's absolute name.
    pub fn topic(&self) -> &str {
        &self.inner.topic
    }

    /// Samples dropped so far because a reader was behind.
    pub fn dropped(&self) -> u64 {
        self.inner.dropped.load(Ordering::Relaxed)
    }

    /// How many subscriptions are connected.
    pub fn subscribers(&self) -> usize {
        self.inner.backend.matched(&self.inner.writer.id())
    }

    /// Waits until at least `number` subscriptions are connected.
    pub async fn wait_for_subscribers(&self, number: usize) {
        let mut changes = self.inner.backend.changes();
        while self.subscribers() < number {
            if changes.changed().await.is_err() {
                return;
            }
        }
    }

    /// Waits until every connected reliable subscription has everything, at most for `timeout`; whether it has.
    ///
    /// # Errors
    /// The middleware failed.
    pub async fn wait_for_acknowledgments(&self, timeout: Duration) -> Result<bool, Error> {
        match tokio::time::timeout(timeout, self.inner.writer.acknowledged()).await {
            Ok(done) => done.map(|()| true),
            Err(_elapsed) => Ok(false),
        }
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.diagnostics.remove_endpoint(&self.writer.id());
    }
}

/// The sending end of a topic of messages `M`. Clones share one endpoint.
pub struct Publisher<M> {
    raw: RawPublisher,
    of: PhantomData<fn(M)>,
}

impl<M> Clone for Publisher<M> {
    fn clone(&self) -> Self {
        Self {
            raw: self.raw.clone(),
            of: PhantomData,
        }
    }
}

impl<M: Message> Publisher<M> {
    pub(crate) fn new(raw: RawPublisher) -> Self {
        Self {
            raw,
            of: PhantomData,
        }
    }

    /// Publishes a message. Never blocks; see [`RawPublisher::publish`].
    ///
    /// # Errors
    /// The message has no CDR form, or the middleware failed.
    pub fn publish(&self, message: &M) -> Result<(), Error> {
        self.raw.publish(cdr::to_bytes(message)?.into())
    }

    /// Publishes a message, waiting until readers that have fallen behind have caught up.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    pub async fn publish_when_ready(&self, message: &M) -> Result<(), Error> {
        self.raw
            .publish_when_ready(cdr::to_bytes(message)?.into())
            .await
    }

    /// The topic's absolute name.
    pub fn topic(&self) -> &str {
        self.raw.topic()
    }

    /// Messages dropped so far because a reader was behind.
    pub fn dropped(&self) -> u64 {
        self.raw.dropped()
    }

    /// How many subscriptions are connected.
    pub fn subscribers(&self) -> usize {
        self.raw.subscribers()
    }

    /// Waits until at least `number` subscriptions are connected.
    pub async fn wait_for_subscribers(&self, number: usize) {
        self.raw.wait_for_subscribers(number).await;
    }

    /// Waits until every connected reliable subscription has everything, at most for `timeout`; whether it has.
    ///
    /// # Errors
    /// The middleware failed.
    pub async fn wait_for_acknowledgments(&self, timeout: Duration) -> Result<bool, Error> {
        self.raw.wait_for_acknowledgments(timeout).await
    }
}
