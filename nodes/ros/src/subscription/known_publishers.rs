//! A property of publishers, for the sinks of a subscription.

use crate::backend::{Backend, DiscoveredEndpoint, EndpointId};
use std::{
    collections::BTreeMap,
    sync::{Arc, Weak},
};

/// The most publishers with a remembered property.
const MAX_PUBLISHERS: usize = 64;

/// A property of the publishers of a subscription, looked up in the graph once for each.
pub(super) struct KnownPublishers {
    backend: Weak<dyn Backend>,
    has: fn(&DiscoveredEndpoint) -> bool,
    known: BTreeMap<EndpointId, bool>,
}

impl KnownPublishers {
    pub(super) fn new(backend: &Arc<dyn Backend>, has: fn(&DiscoveredEndpoint) -> bool) -> Self {
        Self {
            backend: Arc::downgrade(backend),
            has,
            known: BTreeMap::new(),
        }
    }

    /// Of an empty graph.
    #[cfg(test)]
    pub(super) fn of_nothing(has: fn(&DiscoveredEndpoint) -> bool) -> Self {
        Self {
            backend: Weak::<crate::dds::Dds>::new(),
            has,
            known: BTreeMap::new(),
        }
    }

    /// Whether a publisher has the property; `None` for an undiscovered one, which is looked up again at its next
    /// sample.
    pub(super) fn get(&mut self, publisher: &EndpointId) -> Option<bool> {
        if !self.known.contains_key(publisher) {
            if self.known.len() >= MAX_PUBLISHERS {
                self.known.clear();
            }
            let seen = self.backend.upgrade()?.seen();
            let found = seen.iter().find(|seen| seen.id == *publisher)?;
            self.known.insert(*publisher, (self.has)(found));
        }
        self.known.get(publisher).copied()
    }
}
