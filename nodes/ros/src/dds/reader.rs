//! DDS readers.

use super::{
    channel_reader, codec::Raw, identity::is_foreign, own_endpoints::OwnEndpoint,
    received::into_sample, shared::Shared, workarounds::latched::Latest,
};
use crate::{
    Durability,
    backend::{Channel, Endpoint, EndpointId, Reader, Sink},
    local::WAITING,
    mailbox::Mailbox,
};
use bytes::Bytes;
use futures::StreamExt as _;
use rustdds::{Timestamp, no_key::SimpleDataReader};
use std::sync::Arc;
use tokio::task::AbortHandle;

pub(super) struct DdsReader {
    id: EndpointId,
    shared: Arc<Shared>,
    pump: AbortHandle,
    /// Of the samples in a channel of buffers.
    channel: Option<AbortHandle>,
}

impl DdsReader {
    /// `began`: a moment before rustdds made the reader. `own`: the reader as DDS describes it.
    pub(super) fn new(
        reader: SimpleDataReader<Bytes, Raw>,
        began: Timestamp,
        endpoint: &Endpoint,
        own: OwnEndpoint,
        node: &str,
        shared: &Arc<Shared>,
        mut sink: Sink,
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
        shared.own.add(id, own.clone());
        shared.changed();
        let is_server = endpoint.channel == Channel::Request;
        let is_latched = endpoint.qos.durability == Durability::TransientLocal;
        // publishers that latch use no channels
        let has_channel = is_topic && !is_latched && !shared.is_alone;
        let channel = has_channel.then(|| channel_reader::follow(shared, own, Arc::clone(&inbox)));
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
        let pump = shared.failure.watch(&shared.runtime, "subscription", pump);
        Self {
            id,
            shared: Arc::clone(shared),
            pump,
            channel,
        }
    }
}

impl Reader for DdsReader {
    fn id(&self) -> EndpointId {
        self.id
    }
}

impl Drop for DdsReader {
    fn drop(&mut self) {
        // dropping a task drops its DDS reader
        self.pump.abort();
        self.channel.iter().for_each(AbortHandle::abort);
        self.shared.forget(&self.id);
    }
}
