//! Participants that no longer receive this one, while this one receives them: packets are lost in one direction.
//!
//! Once their lease for this participant has run out, they have lost it. rustdds 0.15.1 would never connect them again
//! ([`super::lease`]). They are detected by missing acknowledgements of their reliable readers. rustdds reports when all
//! readers of a writer have acknowledged a sample, not which reader has not. So a participant is a suspect if it reads
//! from a writer without acknowledgements, and from no writer with recent ones ([`super::renewal`]).

use crate::{backend::EndpointId, dds::identity::Peer, lock::lock};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Mutex,
    time::{Duration, Instant},
};

/// The lease that rustdds announces, and a little more.
pub(super) const LEASE: Duration = Duration::from_secs(51);
/// How long an acknowledgement is recent.
const RECENT: Duration = Duration::from_secs(20);

/// Acknowledgements of the readers of other participants.
#[derive(Default)]
pub(in crate::dds) struct OneWay {
    /// The last acknowledgement of each DDS writer.
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

    pub(super) fn start_expiry(&self, peers: &BTreeSet<Peer>) {
        lock(&self.expiring).extend(peers);
    }

    /// Those of `peers` that are not lost yet.
    pub(super) fn expiring(&self, peers: &BTreeSet<Peer>) -> BTreeSet<Peer> {
        &*lock(&self.expiring) & peers
    }

    /// The DDS writers with a recent acknowledgement.
    pub(super) fn recently_acknowledged(&self) -> Vec<EndpointId> {
        let progress = lock(&self.progress);
        let recent = progress.iter().filter(|(_, at)| at.elapsed() < RECENT);
        recent.map(|(line, _)| *line).collect()
    }

    /// Records the state of a DDS writer. `is_acknowledged`: its readers have acknowledged samples since the last call;
    /// `is_waiting`: samples are unacknowledged. Returns whether readers have acknowledged nothing for longer than the lease.
    pub(in crate::dds) fn record(
        &self,
        line: &EndpointId,
        wait: &mut AcknowledgmentWait,
        [is_acknowledged, is_waiting]: [bool; 2],
    ) -> bool {
        let now = Instant::now();
        if is_acknowledged {
            wait.since = None;
            let is_old = |reported: Instant| now - reported > Duration::from_secs(1);
            if wait.reported.is_none_or(is_old) {
                wait.reported = Some(now);
                lock(&self.progress).insert(*line, now);
            }
        }
        if !is_waiting {
            return false;
        }
        let is_lost = now - *wait.since.get_or_insert(now) > LEASE;
        if is_lost {
            wait.since = None;
        }
        is_lost
    }
}

/// How long a publisher has waited for an acknowledgement.
#[derive(Debug, Default)]
pub(in crate::dds) struct AcknowledgmentWait {
    since: Option<Instant>,
    reported: Option<Instant>,
}

impl AcknowledgmentWait {
    pub(in crate::dds) fn is_longer_than(&self, time: Duration) -> bool {
        self.since.is_some_and(|since| since.elapsed() >= time)
    }
}
