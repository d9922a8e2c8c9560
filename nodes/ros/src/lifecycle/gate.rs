//! The gate of a managed node's endpoints. They exist from configure to cleanup, as in rclcpp; the gate is open while
//! the node is active. With a closed gate publishers send nothing, subscriptions skip samples, and services refuse.

use crate::backend::Backend;
use std::sync::{
    Arc, Mutex, PoisonError, Weak,
    atomic::{AtomicBool, Ordering},
};

/// The reaction of an endpoint to a change of the gate.
pub(crate) trait GatedEndpoint: Send + Sync {
    /// The node becomes active: start with an empty queue and the latched samples.
    fn opened(&self, backend: &dyn Backend);
    /// The node becomes inactive: drop waiting samples.
    fn closed(&self);
}

/// Closed until the node is activated. Clones are the same gate.
#[derive(Clone, Default)]
pub(crate) struct Gate(Arc<Inner>);

#[derive(Default)]
struct Inner {
    is_open: AtomicBool,
    endpoints: Mutex<Vec<Weak<dyn GatedEndpoint>>>,
}

impl Gate {
    pub(crate) fn is_open(&self) -> bool {
        self.0.is_open.load(Ordering::Acquire)
    }

    pub(crate) fn add(&self, endpoint: Weak<dyn GatedEndpoint>) {
        self.endpoints().push(endpoint);
    }

    pub(crate) fn open(&self, backend: &dyn Backend) {
        for endpoint in self.live() {
            endpoint.opened(backend);
        }
        self.0.is_open.store(true, Ordering::Release);
    }

    pub(crate) fn close(&self) {
        self.0.is_open.store(false, Ordering::Release);
        for endpoint in self.live() {
            endpoint.closed();
        }
    }

    /// The endpoints that still exist; the others are forgotten. They are called without the lock.
    fn live(&self) -> Vec<Arc<dyn GatedEndpoint>> {
        let mut endpoints = self.endpoints();
        endpoints.retain(|endpoint| endpoint.strong_count() > 0);
        endpoints.iter().filter_map(Weak::upgrade).collect()
    }

    /// No invariant spans the lock.
    fn endpoints(&self) -> std::sync::MutexGuard<'_, Vec<Weak<dyn GatedEndpoint>>> {
        self.0
            .endpoints
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}
