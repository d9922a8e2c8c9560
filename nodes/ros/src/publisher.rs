//! Publishers, typed and raw.

use crate::{
    Diagnostics, Error, Shutdown,
    backend::{Audience, Backend, WhenFull, WriteOutcome, Writer},
    lifecycle::Gate,
    payload::Payload,
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

/// Larger samples \[byte\] do not reliably reach a stock ROS 2 machine: they arrive as one burst of fragments, and a
/// default receive buffer of 212 kB drops some.
const SAFE_SAMPLE_BYTES: usize = 98_000;

/// A publisher that waits for its readers stops waiting for slow ones after this time.
const PATIENCE_WITH_READERS: Duration = Duration::from_secs(5);
/// The interval between checks of a full window.
const RETRY: Duration = Duration::from_millis(10);

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
    /// The gate of a managed node.
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

    /// Publishes a sample: little-endian CDR with its 4-byte header. Never blocks. Policy DropOldest: a reliable
    /// subscription that lags too far loses its oldest samples, which are counted; the others get every sample.
    ///
    /// # Errors
    /// The bytes are not little-endian CDR, or the middleware failed.
    pub fn publish(&self, sample: Bytes) -> Result<(), Error> {
        self.publish_payload(&Payload::Cdr(sample))
    }

    pub(crate) fn publish_payload(&self, payload: &Payload) -> Result<(), Error> {
        if self.is_closed() {
            return Ok(());
        }
        let written = self.inner.writer.write(payload, None, WhenFull::DropOldest);
        match written? {
            WriteOutcome::Sent { dropped, .. } => self.sent(payload, dropped),
            WriteOutcome::Held => self.sent(payload, 0),
            WriteOutcome::WindowFull => self.count_drops(1),
        }
        Ok(())
    }

    /// Whether the node is managed and not active.
    fn is_closed(&self) -> bool {
        self.inner.gate.as_ref().is_some_and(|gate| !gate.is_open())
    }

    fn sent(&self, payload: &Payload, dropped: u64) {
        let inner = &*self.inner;
        if let Some(len) = payload.encoded_len() {
            self.warn_of_size(len);
        }
        if dropped > 0 {
            self.count_drops(dropped);
        }
        inner.diagnostics.sent(&inner.topic);
    }

    fn count_drops(&self, number: u64) {
        let inner = &*self.inner;
        if inner.dropped.fetch_add(number, Ordering::Relaxed) == 0 {
            tracing::warn!(
                "{}: a subscription has fallen behind; its oldest samples are dropped",
                inner.topic
            );
        }
        let reason = format!("{}: a subscription is behind", inner.topic);
        inner.diagnostics.count_drops(&reason, number);
    }

    /// Waits until lagging subscriptions have caught up, then publishes a sample. Policy Block, for at most 5 s: then
    /// the slow subscriptions lose their oldest samples, which are counted. A shutdown ends the wait; the sample is
    /// then dropped and counted.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    pub async fn publish_when_ready(&self, sample: Bytes) -> Result<(), Error> {
        self.publish_payload_when_ready(&Payload::Cdr(sample)).await
    }

    async fn publish_payload_when_ready(&self, payload: &Payload) -> Result<(), Error> {
        let inner = &*self.inner;
        if self.is_closed() {
            return Ok(());
        }
        let patience = tokio::time::sleep(PATIENCE_WITH_READERS);
        let mut patience = std::pin::pin!(patience);
        let mut when_full = WhenFull::Refuse;
        loop {
            match inner.writer.write(payload, None, when_full)? {
                WriteOutcome::Sent { dropped, .. } => {
                    self.sent(payload, dropped);
                    return Ok(());
                }
                WriteOutcome::Held => {
                    self.sent(payload, 0);
                    return Ok(());
                }
                WriteOutcome::WindowFull => {}
            }
            tokio::select! {
                acknowledged = inner.writer.acknowledged() => acknowledged?,
                () = &mut patience, if when_full == WhenFull::Refuse => {
                    when_full = WhenFull::DropOldest;
                }
                () = tokio::time::sleep(RETRY), if when_full == WhenFull::DropOldest => {}
                () = inner.shutdown.wait() => {
                    self.count_drops(1);
                    return Ok(());
                }
            }
        }
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

    /// Number of samples dropped for lagging subscriptions, each counted once per subscription.
    pub fn dropped(&self) -> u64 {
        self.inner.dropped.load(Ordering::Relaxed)
    }

    /// The number of connected subscriptions.
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

    /// Waits until every connected reliable subscription has acknowledged all samples; `false` after `timeout`.
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

    /// Publishes a message. Never blocks; see [`RawPublisher::publish`]. It is encoded only for subscriptions outside
    /// this context, and copied once for those inside; [`publish_shared`](Self::publish_shared) saves the copy.
    ///
    /// # Errors
    /// The message has no CDR form, or the middleware failed.
    pub fn publish(&self, message: &M) -> Result<(), Error> {
        match self.payload(message)? {
            Some(payload) => self.raw.publish_payload(&payload),
            None => Ok(()),
        }
    }

    /// The payload for a message; `None` without receivers.
    fn payload(&self, message: &M) -> Result<Option<Payload>, Error> {
        let inner = &*self.raw.inner;
        Ok(match inner.writer.audience() {
            Audience { here: true, .. } => Some(Payload::of(Arc::new(message.clone()))),
            Audience {
                elsewhere: true, ..
            } => Some(Payload::Cdr(cdr::to_bytes(message)?.into())),
            Audience { .. } => {
                inner.diagnostics.sent(&inner.topic);
                None
            }
        })
    }

    /// Publishes a message without a copy: subscriptions of this context get the same `Arc`.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    pub fn publish_shared(&self, message: Arc<M>) -> Result<(), Error> {
        self.raw.publish_payload(&Payload::of(message))
    }

    /// Waits until lagging subscriptions have caught up, then publishes a message; see
    /// [`RawPublisher::publish_when_ready`].
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    pub async fn publish_when_ready(&self, message: &M) -> Result<(), Error> {
        match self.payload(message)? {
            Some(payload) => self.raw.publish_payload_when_ready(&payload).await,
            None => Ok(()),
        }
    }

    /// The topic's absolute name.
    pub fn topic(&self) -> &str {
        self.raw.topic()
    }

    /// Number of messages dropped for lagging subscriptions, each counted once per subscription.
    pub fn dropped(&self) -> u64 {
        self.raw.dropped()
    }

    /// The number of connected subscriptions.
    pub fn subscribers(&self) -> usize {
        self.raw.subscribers()
    }

    /// Waits until at least `number` subscriptions are connected.
    pub async fn wait_for_subscribers(&self, number: usize) {
        self.raw.wait_for_subscribers(number).await;
    }

    /// Waits until every connected reliable subscription has acknowledged all samples; `false` after `timeout`.
    ///
    /// # Errors
    /// The middleware failed.
    pub async fn wait_for_acknowledgments(&self, timeout: Duration) -> Result<bool, Error> {
        self.raw.wait_for_acknowledgments(timeout).await
    }
}
