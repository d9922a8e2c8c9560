//! What was published before a subscription joined, where its publisher latches. In DDS a subscription that asks for it is
//! not connected to publishers that do not latch, and one that does not ask misses it: so a second one asks, once a
//! publisher is there that latches.

use crate::{
    Durability,
    backend::{Backend, Channel, Endpoint, Sink},
};
use std::sync::Arc;
use tokio::{runtime::Handle, task::AbortHandle};

/// Catches up until it is dropped.
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
        sink: Sink,
    ) -> Self {
        let backend = Arc::clone(backend);
        endpoint.qos.durability = Durability::TransientLocal;
        let task = runtime.spawn(async move {
            let mut changes = backend.changes();
            while !has_latching_publisher(&*backend, &endpoint) {
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
                    "{}: cannot receive samples that were latched before: {error}",
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

fn has_latching_publisher(backend: &dyn Backend, endpoint: &Endpoint) -> bool {
    backend.seen().iter().any(|seen| {
        seen.is_writer
            && seen.channel == Channel::Topic
            && seen.name == endpoint.name
            && seen.qos.durability == Durability::TransientLocal
    })
}
