//! DDS readers.

use super::{
    codec::Raw, identity::is_foreign, local::WAITING, shared::Shared, workarounds::latched::Latest,
};
use crate::{
    Durability,
    backend::{Channel, Endpoint, EndpointId, Reader, RequestId, Sample, Sink},
    mailbox::Mailbox,
    payload::Payload,
};
use bytes::Bytes;
use futures::StreamExt as _;
use rustdds::{
    SequenceNumber, Timestamp,
    no_key::{DeserializedCacheChange, SimpleDataReader},
};
use std::sync::Arc;
use tokio::{runtime::Handle, task::AbortHandle};

pub(super) struct DdsReader {
    id: EndpointId,
    shared: Arc<Shared>,
    pump: AbortHandle,
}

impl DdsReader {
    /// `began`: a moment before rustdds made the reader.
    pub(super) fn new(
        reader: SimpleDataReader<Bytes, Raw>,
        began: Timestamp,
        endpoint: &Endpoint,
        node: &str,
        shared: &Arc<Shared>,
        mut sink: Sink,
        runtime: &Handle,
    ) -> Self {
        let id = reader.guid().to_bytes();
        let inbox = if endpoint.receives_own {
            shared.local.add_reader(id, endpoint)
        } else {
            Arc::new(Mailbox::new(WAITING))
        };
        let is_topic = endpoint.channel == Channel::Topic;
        if is_topic {
            shared.parts.add_reader(id, endpoint, &inbox);
        }
        shared.nodes.add_endpoint(id, node, endpoint, false);
        shared.changed();
        let is_server = endpoint.channel == Channel::Request;
        let is_latched = endpoint.qos.durability == Durability::TransientLocal;
        let graph = Arc::clone(shared);
        let mut began = Some(began);
        let mut latest = Latest::default();
        let pump = async move {
            let mut samples = std::pin::pin!(reader.as_async_stream());
            loop {
                let sample = tokio::select! {
                    Some(sample) = inbox.pop() => Ok(sample),
                    Some(sample) = samples.next() => match sample {
                        Ok(change) => {
                            let writer = change.writer_guid().to_bytes();
                            if graph.is_own(&writer) {
                                continue;
                            }
                            if began.is_some_and(|began| change.receive_instant < began) {
                                // rustdds keeps a topic's last samples for all readers: a new reader would get the
                                // samples of its predecessor, and of writers that are gone
                                if !(is_latched && graph.is_there(&writer)) {
                                    continue;
                                }
                            } else {
                                // from here on, samples arrive in order even if the wall clock is set back
                                began = None;
                            }
                            if is_latched
                                && !is_foreign(&id, &writer)
                                && let Some(time) = change.source_timestamp()
                                && latest.supersedes(writer, time)
                            {
                                continue;
                            }
                            let sample = into_sample(change, is_server);
                            if is_topic && !graph.parts.delivers(&id, &sample) {
                                continue;
                            }
                            Ok(sample)
                        }
                        Err(error) => Err(error.to_string()),
                    },
                    else => break,
                };
                sink(sample);
            }
        };
        let pump = shared.failure.watch(runtime, "subscription", pump);
        Self {
            id,
            shared: Arc::clone(shared),
            pump,
        }
    }
}

fn into_sample(change: DeserializedCacheChange<Bytes>, is_server: bool) -> Sample {
    let (writer, sequence) = (
        change.writer_guid().to_bytes(),
        i64::from(change.sequence_number),
    );
    let mut request = change.related_sample_identity().map(|identity| RequestId {
        client: identity.writer_guid.to_bytes(),
        sequence: identity.sequence_number.into(),
    });
    if is_server {
        // A client may omit its identity, or (Fast DDS) the number: the sample's own ones apply then.
        let request = request.get_or_insert(RequestId {
            client: writer,
            sequence,
        });
        if request.sequence == i64::from(SequenceNumber::UNKNOWN) {
            request.sequence = sequence;
        }
    }
    Sample {
        writer,
        sequence,
        request,
        payload: Payload::Cdr(change.into_value()),
    }
}

impl Reader for DdsReader {
    fn id(&self) -> EndpointId {
        self.id
    }
}

impl Drop for DdsReader {
    fn drop(&mut self) {
        // dropping the task drops the DDS reader
        self.pump.abort();
        self.shared.forget(&self.id);
    }
}
