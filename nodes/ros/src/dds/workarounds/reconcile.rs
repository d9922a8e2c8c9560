//! Compares this runtime's view of the graph with that of rustdds. Events of rustdds come through a channel of 2048,
//! and are lost silently when it is full. A lost event would hide a reader, or keep one that is gone, for ever.

use super::parts::{TYPE, profile};
use crate::{
    backend::EndpointId,
    dds::{lock::lock, shared::Shared},
};
use rustdds::QosPolicies;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex},
    time::Duration,
};

/// How often the two are compared.
const PERIOD: Duration = Duration::from_secs(5);
/// Participants of one host return within this time of each other.
const GATHERING: Duration = Duration::from_millis(100);

/// The topics of the endpoints of this process, as DDS spells them.
#[derive(Default)]
pub(in crate::dds) struct OwnEndpoints {
    table: Mutex<BTreeMap<EndpointId, Own>>,
}

/// An endpoint of this process.
#[derive(Clone)]
pub(in crate::dds) struct Own {
    pub(in crate::dds) topic: String,
    pub(in crate::dds) type_name: String,
    pub(in crate::dds) qos: QosPolicies,
    pub(in crate::dds) is_writer: bool,
}

/// The differences of the last times: an event that is only late is no lost one.
#[derive(Default)]
pub(in crate::dds) struct Suspects {
    last: Mutex<Differences>,
    /// Connections that were made anew the last time.
    rematched: Mutex<BTreeSet<(EndpointId, EndpointId)>>,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct Differences {
    /// Connections that rustdds has made and nobody knows of: own endpoint, other.
    unknown: BTreeSet<(EndpointId, EndpointId)>,
    /// Endpoints of others that are gone.
    ghosts: BTreeSet<EndpointId>,
}

impl Differences {
    /// What both of them say.
    fn confirmed(&self, other: &Self) -> Self {
        Self {
            unknown: &self.unknown & &other.unknown,
            ghosts: &self.ghosts & &other.ghosts,
        }
    }
}

/// An endpoint of another participant, as discovery tells.
struct Other {
    id: EndpointId,
    topic: String,
    qos: QosPolicies,
    is_writer: bool,
}

impl OwnEndpoints {
    pub(in crate::dds) fn add(&self, id: EndpointId, own: Own) {
        lock(&self.table).insert(id, own);
    }

    pub(in crate::dds) fn remove(&self, id: &EndpointId) {
        lock(&self.table).remove(id);
    }
}

/// A writer or reader of large messages in parts.
pub(in crate::dds) fn parts_endpoint(topic: String, is_writer: bool) -> Own {
    Own {
        topic,
        type_name: TYPE.to_owned(),
        qos: profile(),
        is_writer,
    }
}

fn connects(own: &Own, other: &Other) -> bool {
    if own.topic != other.topic || own.is_writer == other.is_writer {
        return false;
    }
    let (offered, requested) = match own.is_writer {
        true => (&own.qos, &other.qos),
        false => (&other.qos, &own.qos),
    };
    offered.compliance_failure_wrt(requested).is_none()
}

impl Shared {
    /// Compares, and mends what is amiss for the second time; whether there was something to mend.
    pub(in crate::dds) fn reconcile(self: &Arc<Self>) -> bool {
        let Some(others) = self.others() else {
            return false;
        };
        let found = self.differences(&others);
        let confirmed = {
            let mut last = lock(&self.suspects.last);
            let confirmed = found.confirmed(&last);
            *last = found;
            confirmed
        };
        let Differences { unknown, ghosts } = &confirmed;
        if unknown.is_empty() && ghosts.is_empty() {
            return false;
        }
        // no event is lost by these: a process was killed, or left as a whole
        if !ghosts.is_empty() {
            tracing::debug!(
                "{} endpoints have gone without a dispose message",
                ghosts.len()
            );
        }
        ghosts.iter().for_each(|id| self.forget_other(id));
        // rustdds has not made the connection, or its event was lost: the first is tried first
        let tried = std::mem::replace(&mut *lock(&self.suspects.rematched), unknown.clone());
        let (made, missing): (BTreeSet<_>, BTreeSet<_>) = unknown
            .iter()
            .copied()
            .partition(|pair| tried.contains(pair));
        if !made.is_empty() {
            tracing::warn!(
                "discovery events were lost: {} connections were unknown, and work from now on",
                made.len()
            );
        }
        for (own, other) in made {
            lock(&self.matches).entry(own).or_default().insert(other);
        }
        self.rematch(&missing.into_iter().map(|(own, _)| own).collect());
        self.changed();
        true
    }

    /// The endpoints of this process that are not connected to all that they could be.
    pub(in crate::dds) fn unconnected(&self) -> BTreeSet<EndpointId> {
        let others = self.others().unwrap_or_default();
        let unknown = self.differences(&others).unknown.into_iter();
        unknown.map(|(own, _)| own).collect()
    }

    /// The endpoints of these identities.
    pub(in crate::dds) fn own_of(&self, ids: &BTreeSet<EndpointId>) -> Vec<(EndpointId, Own)> {
        let own = self.all_own();
        own.into_iter().filter(|(id, _)| ids.contains(id)).collect()
    }

    fn all_own(&self) -> BTreeMap<EndpointId, Own> {
        let mut own = lock(&self.own.table).clone();
        for (id, topic) in self.parts.writers() {
            own.insert(id, parts_endpoint(topic, true));
        }
        own
    }

    /// The endpoints of others that rustdds knows; `None` once the participant is closed.
    fn others(&self) -> Option<Vec<Other>> {
        let participant = lock(&self.participant);
        let participant = participant.as_ref()?;
        let readers = participant.discovered_readers().into_iter().map(|reader| {
            let guid = reader.reader_proxy.remote_reader_guid;
            let topic = &reader.subscription_topic_data;
            self.parts.add_peer(guid, topic.topic_name());
            Other {
                id: guid.to_bytes(),
                topic: topic.topic_name().clone(),
                qos: topic.qos(),
                is_writer: false,
            }
        });
        let writers = participant.discovered_writers().into_iter().map(|writer| {
            let topic = &writer.publication_topic_data;
            Other {
                id: writer.writer_proxy.remote_writer_guid.to_bytes(),
                topic: topic.topic_name.clone(),
                qos: topic.qos(),
                is_writer: true,
            }
        });
        let others = readers.chain(writers);
        Some(others.filter(|other| !self.is_own(&other.id)).collect())
    }

    fn differences(&self, others: &[Other]) -> Differences {
        let own = self.all_own();
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
        let mut by_topic = BTreeMap::<&str, Vec<&Other>>::new();
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

/// Compares for as long as the participant is there, and at once when a participant has returned.
pub(in crate::dds) async fn keep_reconciled(shared: Arc<Shared>) {
    let mut period = tokio::time::interval(PERIOD);
    period.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = period.tick() => {
                shared.reconcile();
            }
            () = shared.has_returned.notified() => {
                tokio::time::sleep(GATHERING).await;
                shared.rematch(&shared.unconnected());
                shared.nodes.tell();
            }
        }
    }
}
