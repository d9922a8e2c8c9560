//! Further readers of a subscription, for publishers that its own reader does not serve. In DDS one reader requests one
//! reliability and one durability. If it requests transient local, it is not connected to volatile publishers; if it does
//! not, it misses the latched samples. If it requests reliable, it is not connected to best-effort publishers; if it does
//! not, samples may be lost. So a further reader is made as soon as a publisher appears that needs it.

use crate::{
    Durability, Reliability,
    backend::{Backend, Channel, Endpoint, Seen, Sink},
};
use std::sync::Arc;
use tokio::{runtime::Handle, task::AbortHandle};

/// The publishers that a further reader serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Served {
    /// Those that latch: the reader gets what was published before.
    Latching,
    /// Those that are best effort.
    BestEffort,
}

impl Served {
    fn is_of(self, publisher: &Seen) -> bool {
        match self {
            Self::Latching => publisher.qos.durability == Durability::TransientLocal,
            Self::BestEffort => publisher.qos.reliability == Reliability::BestEffort,
        }
    }
}

/// A further reader, until it is dropped.
pub(crate) struct CatchUp {
    task: AbortHandle,
}

impl CatchUp {
    /// `endpoint` is the subscription's own, `node` the full name of its node.
    pub(crate) fn begin(
        runtime: &Handle,
        backend: &Arc<dyn Backend>,
        node: String,
        mut endpoint: Endpoint,
        served: Served,
        sink: Sink,
    ) -> Self {
        let backend = Arc::clone(backend);
        endpoint.has_siblings = true;
        match served {
            Served::Latching => endpoint.qos.durability = Durability::TransientLocal,
            Served::BestEffort => endpoint.qos.reliability = Reliability::BestEffort,
        }
        let task = runtime.spawn(async move {
            let mut changes = backend.changes();
            while !has_publisher(&*backend, &endpoint, served) {
                if changes.changed().await.is_err() {
                    return;
                }
            }
            match backend.reader(&node, &endpoint, sink) {
                Ok(reader) => {
                    let _held = reader;
                    std::future::pending::<()>().await;
                }
                Err(error) => tracing::warn!(
                    "{}: cannot receive from publishers that are {served:?}: {error}",
                    endpoint.name
                ),
            }
        });
        let task = task.abort_handle();
        Self { task }
    }
}

impl Drop for CatchUp {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn has_publisher(backend: &dyn Backend, endpoint: &Endpoint, served: Served) -> bool {
    backend.seen().iter().any(|seen| {
        seen.is_writer
            && seen.channel == Channel::Topic
            && seen.name == endpoint.name
            && served.is_of(seen)
    })
}
