//! Further readers of a subscription, for publishers that its own reader does not serve. In DDS one reader requests one
//! reliability and one durability. If it requests transient local, it is not connected to volatile publishers; if it
//! does not, it misses the latched samples. If it requests reliable, it is not connected to best-effort publishers; if
//! it does not, samples may be lost. So a further reader is made when a publisher appears that needs it.

use crate::{
    Durability, Reliability,
    backend::{Backend, Channel, DiscoveredEndpoint, Endpoint, Sink},
};
use std::{
    fmt,
    sync::{Arc, OnceLock},
};
use tokio::{runtime::Handle, task::AbortHandle};

/// The kind of publishers that a further reader serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PublisherKind {
    /// Publishers that latch: the reader gets their latched samples.
    Latching,
    /// Best-effort publishers.
    BestEffort,
}

impl fmt::Display for PublisherKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Latching => "latching",
            Self::BestEffort => "best-effort",
        })
    }
}

impl PublisherKind {
    fn is_of(self, publisher: &DiscoveredEndpoint) -> bool {
        match self {
            Self::Latching => publisher.qos.durability == Durability::TransientLocal,
            Self::BestEffort => publisher.qos.reliability == Reliability::BestEffort,
        }
    }
}

/// A further reader; dropping it ends it.
pub(crate) struct FurtherReader {
    task: AbortHandle,
    failure: Arc<OnceLock<String>>,
}

impl FurtherReader {
    /// `endpoint` is that of the subscription, `node` the full name of its node.
    pub(crate) fn begin(
        runtime: &Handle,
        backend: &Arc<dyn Backend>,
        node: String,
        mut endpoint: Endpoint,
        kind: PublisherKind,
        sink: Sink,
    ) -> Self {
        let backend = Arc::clone(backend);
        endpoint.has_siblings = true;
        match kind {
            PublisherKind::Latching => endpoint.qos.durability = Durability::TransientLocal,
            PublisherKind::BestEffort => endpoint.qos.reliability = Reliability::BestEffort,
        }
        let failure: Arc<OnceLock<String>> = Arc::default();
        let failed = Arc::clone(&failure);
        let task = runtime.spawn(async move {
            let mut changes = backend.changes();
            while !has_publisher(&*backend, &endpoint, kind) {
                if changes.changed().await.is_err() {
                    return;
                }
            }
            match backend.reader(&node, &endpoint, sink) {
                Ok(reader) => {
                    let _held = reader;
                    std::future::pending::<()>().await;
                }
                Err(error) => {
                    let name = &endpoint.name;
                    let text = format!("{name}: cannot receive from {kind} publishers: {error}");
                    tracing::warn!("{text}");
                    failed.get_or_init(|| text);
                }
            }
        });
        let task = task.abort_handle();
        Self { task, failure }
    }

    /// Why its publishers are not connected, if it could not be made.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }
}

impl Drop for FurtherReader {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn has_publisher(backend: &dyn Backend, endpoint: &Endpoint, kind: PublisherKind) -> bool {
    backend.seen().iter().any(|seen| {
        seen.is_writer
            && seen.channel == Channel::Topic
            && seen.name == endpoint.name
            && kind.is_of(seen)
    })
}
