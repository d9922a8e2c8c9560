//! Delivery within the process, without encoding, for every middleware: readers ignore samples of their own process that
//! the middleware delivers.

use crate::{
    Durability, Qos,
    backend::{Channel, Endpoint, EndpointId, RequestId, Sample},
    lock::lock,
    mailbox::Mailbox,
    names::TypeName,
    payload::Payload,
};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex},
    time::Instant,
};

/// Samples that wait for a reader's task.
pub(crate) const WAITING: usize = 512;

/// Two endpoints with equal topics are connected if their QoS matches.
#[derive(Clone, PartialEq, Eq)]
struct Topic {
    channel: Channel,
    name: String,
    type_name: TypeName,
}

struct LocalWriter {
    topic: Topic,
    qos: Qos,
    /// The last `depth` samples for late readers; empty for a volatile writer.
    history: VecDeque<Sample>,
}

struct LocalReader {
    topic: Topic,
    qos: Qos,
    inbox: Arc<Mailbox<Sample>>,
}

#[derive(Default)]
struct Table {
    writers: BTreeMap<EndpointId, LocalWriter>,
    readers: BTreeMap<EndpointId, LocalReader>,
}

/// The endpoints of this process and the delivery between them.
#[derive(Default)]
pub(crate) struct Local {
    table: Mutex<Table>,
}

fn topic_of(endpoint: &Endpoint) -> Topic {
    Topic {
        channel: endpoint.channel,
        name: endpoint.name.clone(),
        type_name: endpoint.type_name.clone(),
    }
}

impl Local {
    pub(crate) fn add_writer(&self, id: EndpointId, endpoint: &Endpoint) {
        let writer = LocalWriter {
            topic: topic_of(endpoint),
            qos: endpoint.qos,
            history: VecDeque::new(),
        };
        lock(&self.table).writers.insert(id, writer);
    }

    /// Returns the reader's inbox, which already holds the latched samples.
    pub(crate) fn add_reader(&self, id: EndpointId, endpoint: &Endpoint) -> Arc<Mailbox<Sample>> {
        let inbox = Arc::new(Mailbox::new(WAITING));
        let reader = LocalReader {
            topic: topic_of(endpoint),
            qos: endpoint.qos,
            inbox: Arc::clone(&inbox),
        };
        let mut table = lock(&self.table);
        if reader.qos.durability == Durability::TransientLocal {
            for writer in table
                .writers
                .values()
                .filter(|writer| connects(writer, &reader))
            {
                for sample in &writer.history {
                    reader.inbox.push(sample.clone());
                }
            }
        }
        table.readers.insert(id, reader);
        inbox
    }

    pub(crate) fn remove(&self, id: &EndpointId) {
        let mut table = lock(&self.table);
        table.writers.remove(id);
        table.readers.remove(id);
    }

    pub(crate) fn deliver(
        &self,
        writer: EndpointId,
        sequence: i64,
        payload: &Payload,
        answers: Option<RequestId>,
    ) {
        let mut table = lock(&self.table);
        let Table { writers, readers } = &mut *table;
        let Some(from) = writers.get_mut(&writer) else {
            return;
        };
        // As on the wire: writer and number identify a request, the request's identity its response.
        let request = answers.unwrap_or(RequestId {
            client: writer,
            sequence,
        });
        let sample = Sample {
            payload: payload.clone(),
            writer,
            sequence,
            arrived: Instant::now(),
            request: Some(request),
        };
        for reader in readers.values().filter(|reader| connects(from, reader)) {
            reader.inbox.push(sample.clone());
        }
        if from.qos.durability == Durability::TransientLocal {
            from.history.push_back(sample);
            while from.history.len() > from.qos.depth.max(1) {
                from.history.pop_front();
            }
        }
    }

    #[cfg_attr(
        not(feature = "zenoh"),
        allow(dead_code, reason = "DDS has readers of its own")
    )]
    /// Hands a sample from another process to the readers of an endpoint's topic or service.
    pub(crate) fn receive(&self, endpoint: &Endpoint, sample: &Sample) {
        let (topic, table) = (topic_of(endpoint), lock(&self.table));
        for reader in table
            .readers
            .values()
            .filter(|reader| reader.topic == topic)
        {
            reader.inbox.push(sample.clone());
        }
    }

    /// How many endpoints of this process are connected to the endpoint.
    pub(crate) fn matched(&self, id: &EndpointId) -> usize {
        let table = lock(&self.table);
        if let Some(writer) = table.writers.get(id) {
            return table
                .readers
                .values()
                .filter(|reader| connects(writer, reader))
                .count();
        }
        table.readers.get(id).map_or(0, |reader| {
            table
                .writers
                .values()
                .filter(|writer| connects(writer, reader))
                .count()
        })
    }
}

fn connects(writer: &LocalWriter, reader: &LocalReader) -> bool {
    writer.topic == reader.topic && reader.qos.matches(&writer.qos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;

    fn endpoint(name: &str, qos: Qos) -> Endpoint {
        let type_name = TypeName::message("std_msgs", "Bool");
        Endpoint {
            channel: Channel::Topic,
            name: name.into(),
            type_name,
            type_info: None,
            qos,
            receives_own: true,
            has_siblings: false,
        }
    }

    fn sequences(inbox: &Mailbox<Sample>) -> Vec<i64> {
        std::iter::from_fn(|| inbox.try_pop())
            .map(|sample| sample.sequence)
            .collect()
    }

    #[test]
    fn samples_reach_only_matching_readers() {
        let local = Local::default();
        let [writer, reader, picky, other] = [1, 2, 3, 4].map(|byte| [byte; 16]);
        local.add_writer(writer, &endpoint("/a", Qos::best_effort(1)));
        let inbox = local.add_reader(reader, &endpoint("/a", Qos::best_effort(1)));
        let picky_inbox = local.add_reader(picky, &endpoint("/a", Qos::reliable(1)));
        let other_inbox = local.add_reader(other, &endpoint("/b", Qos::best_effort(1)));
        assert_eq!(
            (
                local.matched(&writer),
                local.matched(&reader),
                local.matched(&picky)
            ),
            (1, 1, 0)
        );
        local.deliver(writer, 1, &Payload::Cdr(Bytes::new()), None);
        assert_eq!(
            (
                sequences(&inbox),
                sequences(&picky_inbox),
                sequences(&other_inbox)
            ),
            (vec![1], vec![], vec![])
        );
        local.remove(&reader);
        assert_eq!(local.matched(&writer), 0);
    }

    #[test]
    fn late_latched_reader_gets_the_last_samples() {
        let local = Local::default();
        let [writer, late, volatile] = [1, 2, 3].map(|byte| [byte; 16]);
        local.add_writer(writer, &endpoint("/a", Qos::latched(2)));
        for sequence in 1..=3 {
            local.deliver(writer, sequence, &Payload::Cdr(Bytes::new()), None);
        }
        assert_eq!(
            sequences(&local.add_reader(late, &endpoint("/a", Qos::latched(1)))),
            [2, 3]
        );
        assert_eq!(
            sequences(&local.add_reader(volatile, &endpoint("/a", Qos::reliable(1)))),
            [0i64; 0]
        );
    }
}
