//! Compares this runtime's view of the graph with that of rustdds. Events of rustdds pass a channel of 2048 and are
//! silently lost when it is full. A lost event would hide a reader forever, or keep one that is gone.

use crate::{
    backend::EndpointId,
    dds::{own_endpoints::OwnEndpoint, shared::Shared},
    lock::lock,
};
use rustdds::QosPolicies;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

/// How often the views are compared.
const PERIOD: Duration = Duration::from_secs(5);
/// Participants of one host return within this time of each other.
const GATHERING: Duration = Duration::from_millis(100);

#[derive(Clone, Debug, Default, PartialEq)]
struct Differences {
    /// Connections without an event: own endpoint, remote endpoint.
    unknown: BTreeSet<(EndpointId, EndpointId)>,
    /// Remote endpoints that are gone.
    ghosts: BTreeSet<EndpointId>,
}

impl Differences {
    /// The differences in both.
    fn common(&self, other: &Self) -> Self {
        Self {
            unknown: &self.unknown & &other.unknown,
            ghosts: &self.ghosts & &other.ghosts,
        }
    }
}

/// A discovered endpoint of another participant.
struct RemoteEndpoint {
    id: EndpointId,
    topic: String,
    qos: QosPolicies,
    is_writer: bool,
}

fn connects(own: &OwnEndpoint, other: &RemoteEndpoint) -> bool {
    if own.topic != other.topic || own.is_writer == other.is_writer {
        return false;
    }
    let (offered, requested) = match own.is_writer {
        true => (&own.qos, &other.qos),
        false => (&other.qos, &own.qos),
    };
    offered.compliance_failure_wrt(requested).is_none()
}

pub(in crate::dds) struct Reconciler {
    shared: Arc<Shared>,
    /// The differences of the last comparison: a late event is not lost.
    last: Differences,
    /// Connections that were made anew after the last comparison.
    rematched: BTreeSet<(EndpointId, EndpointId)>,
}

impl Reconciler {
    pub(in crate::dds) fn new(shared: Arc<Shared>) -> Self {
        Self {
            shared,
            last: Differences::default(),
            rematched: BTreeSet::new(),
        }
    }

    /// Compares while the participant exists, and at once when another participant returns.
    pub(in crate::dds) async fn run(mut self) {
        let mut period = tokio::time::interval(PERIOD);
        period.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                _ = period.tick() => {
                    self.reconcile();
                }
                () = self.shared.has_returned.notified() => {
                    tokio::time::sleep(GATHERING).await;
                    self.shared.rematch(&self.shared.unconnected());
                    self.shared.nodes.announce();
                }
            }
        }
    }

    /// Compares, and repairs each difference that the last comparison found too. Returns whether it repaired any.
    pub(in crate::dds) fn reconcile(&mut self) -> bool {
        let shared = &self.shared;
        let Some(others) = shared.others() else {
            return false;
        };
        let found = shared.differences(&others);
        let Differences { unknown, ghosts } = found.common(&self.last);
        self.last = found;
        if unknown.is_empty() && ghosts.is_empty() {
            return false;
        }
        // no event was lost: a process was killed, or left as a whole
        if !ghosts.is_empty() {
            tracing::debug!(
                "{} endpoints have gone without a dispose message",
                ghosts.len()
            );
        }
        ghosts.iter().for_each(|id| shared.forget_other(id));
        // Either rustdds has not made the connection or its event was lost: assume the former first.
        let tried = std::mem::replace(&mut self.rematched, unknown.clone());
        let (made, missing): (BTreeSet<_>, BTreeSet<_>) =
            unknown.into_iter().partition(|pair| tried.contains(pair));
        if !made.is_empty() {
            tracing::warn!(
                "discovery events were lost: {} connections were unknown, and work from now on",
                made.len()
            );
        }
        for (own, other) in made {
            lock(&shared.matches).entry(own).or_default().insert(other);
        }
        shared.rematch(&missing.into_iter().map(|(own, _)| own).collect());
        shared.changed();
        true
    }
}

impl Shared {
    /// The own endpoints that lack a connection.
    fn unconnected(&self) -> BTreeSet<EndpointId> {
        let Some(others) = self.others() else {
            return BTreeSet::new();
        };
        let unknown = self.differences(&others).unknown.into_iter();
        unknown.map(|(own, _)| own).collect()
    }

    /// The discovered endpoints of other participants; `None` once the participant is closed.
    fn others(&self) -> Option<Vec<RemoteEndpoint>> {
        let participant = lock(&self.participant);
        let participant = participant.as_ref()?;
        let readers = participant.discovered_readers().into_iter().map(|reader| {
            let guid = reader.reader_proxy.remote_reader_guid;
            let topic = &reader.subscription_topic_data;
            self.parts.add_peer(guid, topic.topic_name());
            RemoteEndpoint {
                id: guid.to_bytes(),
                topic: topic.topic_name().clone(),
                qos: topic.qos(),
                is_writer: false,
            }
        });
        let writers = participant.discovered_writers().into_iter().map(|writer| {
            let topic = &writer.publication_topic_data;
            self.buffer_channels.detect(&topic.topic_name);
            RemoteEndpoint {
                id: writer.writer_proxy.remote_writer_guid.to_bytes(),
                topic: topic.topic_name.clone(),
                qos: topic.qos(),
                is_writer: true,
            }
        });
        let others = readers.chain(writers);
        Some(others.filter(|other| !self.is_own(&other.id)).collect())
    }

    fn differences(&self, others: &[RemoteEndpoint]) -> Differences {
        let own = self.own_endpoints();
        let there: BTreeSet<EndpointId> = others.iter().map(|other| other.id).collect();
        let mut writers = lock(&self.writers);
        let there_write = others.iter().filter(|other| other.is_writer);
        writers.extend(there_write.map(|other| other.id));
        let mut believed: BTreeSet<EndpointId> = writers.iter().copied().collect();
        drop(writers);
        believed.extend(self.parts.readers());
        let matches = lock(&self.matches);
        believed.extend(matches.values().flatten());
        let mut differences = Differences {
            ghosts: &believed - &there,
            ..Differences::default()
        };
        let mut by_topic = BTreeMap::<&str, Vec<&RemoteEndpoint>>::new();
        for other in others {
            by_topic.entry(&other.topic).or_default().push(other);
        }
        for (id, own) in &own {
            let known = matches.get(id);
            let on_topic = by_topic.get(own.topic.as_str()).into_iter().flatten();
            for other in on_topic.filter(|other| connects(own, other)) {
                if !known.is_some_and(|known| known.contains(&other.id)) {
                    differences.unknown.insert((*id, other.id));
                }
            }
        }
        differences
    }
}
