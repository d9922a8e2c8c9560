//! Connections to participants that return after their lease ran out.
//!
//! rustdds 0.15.1 remembers the endpoints of such a participant, but connects to them only when they are announced
//! anew, which the other side does not do. rustdds also connects all endpoints of a topic when this process makes a new
//! one on it. So a temporary endpoint is made on each topic that lacks a connection. The connections keep their
//! identities and numbers, so readers receive no sample twice.

use crate::{
    Error, Qos,
    backend::EndpointId,
    dds::{
        codec::Raw,
        own_endpoints::OwnEndpoint,
        qos::for_reader,
        shared::{SecondParticipant, Shared},
    },
    lock::lock,
};
use bytes::Bytes;
use rustdds::{
    DomainParticipant, Publisher, RTPSEntity as _, TopicKind,
    no_key::{DataWriter, SimpleDataReader},
};
use std::{collections::BTreeSet, sync::Arc, time::Duration};

/// How long a temporary endpoint stays: rustdds connects it within milliseconds.
const STAY: Duration = Duration::from_secs(1);

/// An endpoint that only triggers connections.
enum Temporary {
    Writer(DataWriter<Bytes, Raw>),
    Reader(SimpleDataReader<Bytes, Raw>),
}

impl Temporary {
    fn id(&self) -> EndpointId {
        match self {
            Self::Writer(writer) => writer.guid().to_bytes(),
            Self::Reader(reader) => reader.guid().to_bytes(),
        }
    }
}

impl Shared {
    /// Makes rustdds connect these own endpoints with all that match.
    pub(in crate::dds) fn rematch(self: &Arc<Self>, ids: &BTreeSet<EndpointId>) {
        let mut topics = BTreeSet::new();
        let mut temporary = Vec::new();
        for (id, own) in self.own_endpoints() {
            if !ids.contains(&id) {
                continue;
            }
            let is_of_first = id.starts_with(&self.first);
            if !topics.insert((own.topic.clone(), own.is_writer, is_of_first)) {
                continue;
            }
            match self.temporary(&own, is_of_first) {
                Ok(endpoint) => temporary.extend(endpoint),
                Err(error) => tracing::debug!("{error}"),
            }
        }
        if temporary.is_empty() {
            return;
        }
        tracing::debug!("{} topics are connected anew", temporary.len());
        let shared = Arc::clone(self);
        self.failure.watch(&self.runtime, "discovery", async move {
            tokio::time::sleep(STAY).await;
            for endpoint in temporary {
                lock(&shared.matches).remove(&endpoint.id());
                drop(endpoint);
            }
        });
    }

    /// `None` once the participant is closed.
    fn temporary(&self, own: &OwnEndpoint, is_of_first: bool) -> Result<Option<Temporary>, Error> {
        let first = lock(&self.participant);
        let second = lock(&self.second);
        let (participant, publisher): (Option<&DomainParticipant>, Option<&Publisher>) =
            match (is_of_first, second.as_ref()) {
                (true, _) => (first.as_ref(), Some(&self.publisher)),
                (
                    false,
                    Some(SecondParticipant {
                        participant,
                        publisher,
                    }),
                ) => (Some(participant), Some(publisher)),
                (false, None) => (None, None),
            };
        let (Some(participant), Some(publisher)) = (participant, publisher) else {
            return Ok(None);
        };
        let failed = |error| Error::middleware(format!("connect {}", own.topic), error);
        // A best-effort, volatile reader matches every writer. A writer has to offer the QoS of the own one.
        let qos = for_reader(Qos::best_effort(1));
        let (name, type_name) = (own.topic.clone(), own.type_name.clone());
        let topic = participant
            .create_topic(name, type_name, &qos, TopicKind::NoKey)
            .map_err(failed)?;
        Ok(Some(match own.is_writer {
            true => Temporary::Writer(
                publisher
                    .create_datawriter_no_key(&topic, Some(own.qos.clone()))
                    .map_err(failed)?,
            ),
            false => Temporary::Reader(
                self.subscriber
                    .create_simple_datareader_no_key(&topic, Some(qos))
                    .map_err(failed)?,
            ),
        }))
    }
}
