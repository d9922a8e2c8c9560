//! The reader of the samples that ROS 2 Lyrical does not publish on their topic; see [`super::buffer_channels`].

use super::{
    buffer_channels::CPU, codec::Raw, own_endpoints::OwnEndpoint, received::into_sample,
    shared::Shared,
};
use crate::{
    Error,
    backend::{EndpointId, Sample},
    lock::lock,
    mailbox::Mailbox,
};
use bytes::Bytes;
use futures::StreamExt as _;
use rustdds::{Timestamp, TopicKind, no_key::SimpleDataReader};
use std::{collections::BTreeSet, sync::Arc};
use tokio::task::AbortHandle;

/// The reader of a channel; dropping it ends the connections.
struct ChannelReader {
    id: EndpointId,
    shared: Arc<Shared>,
    reader: SimpleDataReader<Bytes, Raw>,
}

impl ChannelReader {
    /// `None` once the participant is closed.
    fn new(shared: &Arc<Shared>, topic_reader: &OwnEndpoint) -> Result<Option<Self>, Error> {
        let own = OwnEndpoint {
            topic: format!("{}{CPU}", topic_reader.topic),
            ..topic_reader.clone()
        };
        let participant = lock(&shared.participant);
        let Some(participant) = participant.as_ref() else {
            return Ok(None);
        };
        let failed = |error| Error::middleware(format!("subscribe to {}", own.topic), error);
        let (name, type_name) = (own.topic.clone(), own.type_name.clone());
        let topic = participant
            .create_topic(name, type_name, &own.qos, TopicKind::NoKey)
            .map_err(failed)?;
        let reader = shared
            .subscriber
            .create_simple_datareader_no_key(&topic, Some(own.qos.clone()))
            .map_err(failed)?;
        let id = reader.guid().to_bytes();
        // the topic's reader reports a QoS that does not match
        shared.mismatches.tolerate(id);
        shared.own.add(id, own);
        Ok(Some(Self {
            id,
            shared: Arc::clone(shared),
            reader,
        }))
    }
}

impl Drop for ChannelReader {
    fn drop(&mut self) {
        self.shared.forget(&self.id);
    }
}

/// Puts the samples of the channel of a topic into the inbox of the topic's reader, once there is a channel.
pub(super) fn follow(
    shared: &Arc<Shared>,
    topic_reader: OwnEndpoint,
    inbox: Arc<Mailbox<Sample>>,
) -> AbortHandle {
    let graph = Arc::clone(shared);
    let task = async move {
        let mut channels = graph.buffer_channels.watch();
        let is_there = |topics: &BTreeSet<String>| topics.contains(&topic_reader.topic);
        if channels.wait_for(is_there).await.is_err() {
            return;
        }
        let began = Timestamp::now();
        let channel = match ChannelReader::new(&graph, &topic_reader) {
            Ok(Some(channel)) => channel,
            Ok(None) => return,
            Err(error) => {
                tracing::warn!("samples of ROS 2 Lyrical may be missing: {error}");
                return;
            }
        };
        let mut samples = std::pin::pin!(channel.reader.as_async_stream());
        while let Some(sample) = samples.next().await {
            match sample {
                // rustdds keeps a topic's last samples for all readers
                Ok(change) if change.receive_instant < began => {}
                Ok(change) => {
                    inbox.push(into_sample(change, false));
                }
                Err(error) => tracing::debug!("{}{CPU}: {error}", topic_reader.topic),
            }
        }
    };
    shared.failure.watch(&shared.runtime, "subscription", task)
}
