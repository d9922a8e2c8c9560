//! Connects participants anew that no longer receive this one; see [`super::one_way`].

use super::one_way::LEASE;
use crate::{
    Reliability,
    backend::EndpointId,
    dds::identity::participant_of,
    dds::{
        identity::{Peer, is_foreign},
        qos,
        shared::Shared,
    },
};
use std::{collections::BTreeSet, sync::Arc, time::Duration};

/// An announcement of the participant just after an expiry cancels it, so the expiry is repeated.
const REPEATS: usize = 4;
const PAUSE: Duration = Duration::from_millis(1500);

impl Shared {
    /// Ends the leases of the participants that have acknowledged nothing from the DDS writer `line`.
    pub(in crate::dds) fn renew(self: &Arc<Self>, line: &EndpointId) {
        let Some(own_port) = self.own_port.get() else {
            return; // on loopback no packets are lost
        };
        let suspects = self.suspects_of(line);
        let host = |peer: &Peer| [peer[2], peer[3]]; // as Fast DDS encodes it
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
        self.one_way.start_expiry(&suspects);
        let (shared, own_port) = (Arc::clone(self), Arc::clone(own_port));
        self.failure.watch(&self.runtime, "discovery", async move {
            for _ in 0..REPEATS {
                let left = shared.one_way.expiring(&suspects);
                left.iter().for_each(|peer| own_port.expire(peer));
                tokio::time::sleep(PAUSE).await;
            }
            suspects.iter().for_each(|peer| shared.one_way.lost(peer));
        });
    }

    /// Participants of other implementations: participants of this suite renew their connections themselves.
    fn suspects_of(&self, line: &EndpointId) -> BTreeSet<Peer> {
        let readers = self.discovered_readers();
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
            reliable.map(participant_of).collect()
        };
        let mut suspects = peers(line);
        for other in self.one_way.recently_acknowledged() {
            let received = peers(&other);
            suspects.retain(|peer| !received.contains(peer));
        }
        suspects
    }
}
