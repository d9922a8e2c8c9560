//! Responses to clients whose reader is not connected yet. A request may arrive earlier than the announcement of the
//! client's reader, and a volatile writer sends only to connected readers. So such a response waits, as in
//! rmw_fastrtps; otherwise the call would never end.

use super::{identity::is_same_participant, shared::Shared};
use crate::{backend::EndpointId, lock::lock};
use std::{collections::BTreeSet, time::Duration};

/// The longest wait: discovery takes less than a second, or fails.
const PATIENCE: Duration = Duration::from_secs(10);

impl Shared {
    /// Whether the writer `own` is connected to a reader in the participant of `client`.
    pub(super) fn reaches(&self, own: &EndpointId, client: &EndpointId) -> bool {
        let is_connected = |others: &BTreeSet<EndpointId>| {
            others
                .iter()
                .any(|other| is_same_participant(other, client))
        };
        is_same_participant(own, client) || lock(&self.matches).get(own).is_some_and(is_connected)
    }

    /// Waits until [`Self::reaches`]; false after [`PATIENCE`].
    pub(super) async fn reached(&self, own: &EndpointId, client: &EndpointId) -> bool {
        let mut changes = self.changes.subscribe();
        let wait = async {
            while !self.reaches(own, client) {
                if changes.changed().await.is_err() {
                    return false;
                }
            }
            true
        };
        tokio::time::timeout(PATIENCE, wait).await.unwrap_or(false)
    }
}
