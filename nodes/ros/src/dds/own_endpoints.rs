//! The endpoints of this process as DDS describes them.

use crate::backend::EndpointId;
use crate::lock::lock;
use rustdds::QosPolicies;
use std::{collections::BTreeMap, sync::Mutex};

/// An endpoint of this process. Names are in DDS spelling.
#[derive(Clone)]
pub(super) struct OwnEndpoint {
    pub(super) topic: String,
    pub(super) type_name: String,
    pub(super) qos: QosPolicies,
    pub(super) is_writer: bool,
}

#[derive(Default)]
pub(super) struct OwnEndpoints {
    table: Mutex<BTreeMap<EndpointId, OwnEndpoint>>,
}

impl OwnEndpoints {
    pub(super) fn add(&self, id: EndpointId, own: OwnEndpoint) {
        lock(&self.table).insert(id, own);
    }

    pub(super) fn remove(&self, id: &EndpointId) {
        lock(&self.table).remove(id);
    }

    pub(super) fn all(&self) -> BTreeMap<EndpointId, OwnEndpoint> {
        lock(&self.table).clone()
    }
}
