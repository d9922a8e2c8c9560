//! Participants that no longer receive this one, while this one receives them: packets are lost in one direction.
//!
//! Once their lease for this participant has run out, they have lost it, and would never be connected again
//! ([`super::lease`]). They are found by what their reliable readers do not acknowledge. rustdds 0.15.1 reports when
//! all readers of a writer have acknowledged something, not which one has not. So a participant is suspected that has readers of
//! a writer without acknowledgements, and of no writer with recent ones.

use super::parts::{Peer, peer_of};
use crate::{
    Reliability,
    backend::EndpointId,
    dds::{
        lock::lock,
        qos,
        shared::{Shared, is_foreign},
    },
};
use rustdds::DomainParticipant;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

/// The lease that rustdds announces, and a little more.
const LEASE: Duration = Duration::from_secs(51);
/// Acknowledgements are recent for so long.
const RECENT: Duration = Duration::from_secs(20);
/// An expiry is lost where an announcement of the participant comes at once after it, so it is repeated.
const REPEATS: usize = 4;
const PAUSE: Duration = Duration::from_millis(1500);

/// Acknowledgements of the readers elsewhere.
#[derive(Default)]
pub(in crate::dds) struct OneWay {
    /// When the readers of each DDS writer have acknowledged something last.
    progress: Mutex<BTreeMap<EndpointId, Instant>>,
    /// Participants whose lease is being ended.
    expiring: Mutex<BTreeSet<Peer>>,
}

impl OneWay {
    pub(in crate::dds) fn forget_line(&self, line: &EndpointId) {
        lock(&self.progress).remove(line);
    }

    /// Another participant is lost.
    pub(in crate::dds) fn lost(&self, peer: &Peer) {
        lock(&self.expiring).remove(peer);
    }
}

/// Since when a publisher has waited for an acknowledgement.
#[derive(Debug, Default)]
pub(in crate::dds) struct Waiting {
    since: Option<Instant>,
    reported: Option<Instant>,
}

impl Waiting {
    /// Whether it has waited for this long.
    pub(in crate::dds) fn is_long(&self, time: Duration) -> bool {
        self.since.is_some_and(|since| since.elapsed() >= time)
    }
}

impl Shared {
    /// Takes the state of a DDS writer. `is_acknowledged`: its readers have acknowledged samples since the last call;
    /// `is_waiting`: samples are unacknowledged.
    pub(in crate::dds) fn note(
        self: &Arc<Self>,
        line: &EndpointId,
        waiting: &mut Waiting,
        [is_acknowledged, is_waiting]: [bool; 2],
    ) {
        let now = Instant::now();
        if is_acknowledged {
            waiting.since = None;
            let is_old = |reported: Instant| now - reported > Duration::from_secs(1);
            if waiting.reported.is_none_or(is_old) {
                waiting.reported = Some(now);
                lock(&self.one_way.progress).insert(*line, now);
            }
        }
        if !is_waiting {
            return;
        }
        let since = *waiting.since.get_or_insert(now);
        if now - since > LEASE {
            waiting.since = None;
            self.renew(line);
        }
    }

    /// Ends the lease of the participants that have acknowledged nothing of a DDS writer for longer than the lease here.
    fn renew(self: &Arc<Self>, line: &EndpointId) {
        let Some(own_port) = self.own_port.get() else {
            return; // on loopback no packets are lost
        };
        let suspects = self.suspects_of(line);
        let host = |peer: &Peer| [peer[2], peer[3]]; // as Fast DDS names it
        let mut hosts = suspects.iter().map(host).collect::<BTreeSet<_>>();
        if hosts.pop_first().is_none() {
            return;
        }
        if !hosts.is_empty() {
            tracing::warn!(
                "{} participants of several hosts acknowledge nothing: one of them may not receive this node's messages; \
                 restart it when its network is back",
                suspects.len()
            );
            return;
        }
        tracing::warn!(
            "{} participants of a host have acknowledged nothing for {} s: connecting them anew",
            suspects.len(),
            LEASE.as_secs()
        );
        lock(&self.one_way.expiring).extend(&suspects);
        let (shared, own_port) = (Arc::clone(self), Arc::clone(own_port));
        self.failure.watch(&self.runtime, "discovery", async move {
            for _ in 0..REPEATS {
                let expiring = lock(&shared.one_way.expiring).clone();
                let mut left = suspects.iter().filter(|peer| expiring.contains(*peer));
                left.by_ref().for_each(|peer| own_port.expire(peer));
                tokio::time::sleep(PAUSE).await;
            }
            let mut expiring = lock(&shared.one_way.expiring);
            suspects.iter().for_each(|peer| {
                expiring.remove(peer);
            });
        });
    }

    /// Participants of other implementations, since those of this suite renew their connections themselves.
    fn suspects_of(&self, line: &EndpointId) -> BTreeSet<Peer> {
        let participant = lock(&self.participant);
        let readers = participant
            .as_ref()
            .map(DomainParticipant::discovered_readers)
            .unwrap_or_default();
        drop(participant);
        let reliable = readers.iter().filter(|reader| {
            let qos = qos::from_dds(&reader.subscription_topic_data.qos());
            qos.reliability == Reliability::Reliable
        });
        let reliable: BTreeSet<EndpointId> = reliable
            .map(|reader| reader.reader_proxy.remote_reader_guid.to_bytes())
            .collect();
        let peers = |line: &EndpointId| -> BTreeSet<Peer> {
            let readers = self.matched(line);
            let foreign = readers.iter().filter(|reader| is_foreign(line, reader));
            let reliable = foreign.filter(|reader| reliable.contains(*reader));
            reliable.map(peer_of).collect()
        };
        let progress = lock(&self.one_way.progress).clone();
        let recent = progress.iter().filter(|(_, at)| at.elapsed() < RECENT);
        let mut suspects = peers(line);
        for (other, _) in recent {
            let received = peers(other);
            suspects.retain(|peer| !received.contains(peer));
        }
        suspects
    }
}
