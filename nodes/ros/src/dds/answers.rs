//! Answers to clients whose reader is not connected yet. A client's request may come before the news of its reader
//! does, and a volatile writer's sample goes to none but the readers that it knows: an answer sent at once would be
//! lost, and the call would never end. So it waits, as it does in rmw_fastrtps.

use super::{local::is_same_participant, lock::lock, shared::Shared, workarounds::wire::usable};
use crate::backend::EndpointId;
use rustdds::DomainParticipant;
use std::{
    collections::BTreeSet,
    net::{IpAddr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

/// The longest that an answer waits: discovery takes less than a second, or fails.
const PATIENCE: Duration = Duration::from_secs(10);

/// Answers of one server that may wait at once; bounds the memory.
const PLACES: usize = 64;

/// The places in which the answers of one server wait.
#[derive(Default)]
pub(super) struct WaitingRoom {
    taken: Arc<AtomicUsize>,
}

/// A place taken, until it is dropped.
pub(super) struct Place {
    taken: Arc<AtomicUsize>,
}

impl WaitingRoom {
    /// A place, where one is left.
    pub(super) fn enter(&self) -> Option<Place> {
        let one_more = |taken| (taken < PLACES).then_some(taken + 1);
        self.taken
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_more)
            .ok()?;
        Some(Place {
            taken: Arc::clone(&self.taken),
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.taken.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Shared {
    /// Where these clients' readers are reached.
    pub(super) fn addresses_of(
        &self,
        clients: &BTreeSet<EndpointId>,
    ) -> Vec<(EndpointId, Vec<SocketAddr>)> {
        let interfaces = if_addrs::get_if_addrs().unwrap_or_default();
        let own: Vec<IpAddr> = interfaces.iter().map(if_addrs::Interface::ip).collect();
        let participant = lock(&self.participant);
        let readers = participant
            .as_ref()
            .map(DomainParticipant::discovered_readers)
            .unwrap_or_default();
        drop(participant);
        let proxies = readers.into_iter().map(|reader| reader.reader_proxy);
        proxies
            .map(|proxy| (proxy.remote_reader_guid.to_bytes(), proxy))
            .filter(|(id, _)| clients.contains(id))
            .map(|(id, proxy)| {
                let announced = proxy.unicast_locator_list.into_iter();
                let announced = announced.map(SocketAddr::from);
                (id, usable(announced, &own, self.is_on_loopback))
            })
            .collect()
    }

    /// Whether the writer `own` is connected to a reader in the participant of `client`.
    pub(super) fn reaches(&self, own: &EndpointId, client: &EndpointId) -> bool {
        let is_connected = |others: &BTreeSet<EndpointId>| {
            others
                .iter()
                .any(|other| is_same_participant(other, client))
        };
        is_same_participant(own, client) || lock(&self.matches).get(own).is_some_and(is_connected)
    }

    /// Waits until [`Self::reaches`]; false where that takes too long.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_waiting_room_is_bounded_and_empties() {
        let room = WaitingRoom::default();
        let places: Vec<Place> = std::iter::from_fn(|| room.enter()).collect();
        assert_eq!(places.len(), PLACES);
        drop(places);
        assert!(room.enter().is_some());
    }
}
