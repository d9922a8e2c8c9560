//! Latched messages at a time of a bag.

use std::sync::Arc;

use super::{BagMessage, BagReader, StoredMessage};
use crate::{BagError, LatchedMessages, TopicInfo};

impl BagReader {
    /// The latched messages that a subscriber would have received by this log time (ns since the epoch): the last earlier
    /// message of each latched topic, for `/tf_static` all distinct ones. `wants` selects topics. Reads only segments with
    /// such topics up to that time. Returns read errors too.
    pub fn latched_before(
        &self,
        log_time_ns: u64,
        wants: impl Fn(&TopicInfo) -> bool,
    ) -> (Vec<BagMessage>, Vec<BagError>) {
        let (stored, unreadable) = self.stored_latched_before(log_time_ns, wants);
        let messages = stored
            .iter()
            .filter_map(|(_, message)| self.message_of(message));
        (messages.collect(), unreadable)
    }

    /// [`latched_before`](Self::latched_before), as stored, each with its topic.
    pub(crate) fn stored_latched_before(
        &self,
        log_time_ns: u64,
        wants: impl Fn(&TopicInfo) -> bool,
    ) -> (Vec<(Arc<str>, StoredMessage)>, Vec<BagError>) {
        let topics = self.topics().iter();
        let topics = topics.filter(|topic| topic.is_latched() && wants(topic));
        let topics: Vec<Arc<str>> = topics.map(|topic| Arc::clone(&topic.name)).collect();
        let messages = self
            .stored_messages(|messages| messages.only_topics(topics).ending_before(log_time_ns));
        let (mut latched, mut unreadable) = (LatchedMessages::default(), Vec::new());
        for message in messages {
            match message {
                Ok(message) => {
                    let file = self.index.get(message.file);
                    let channels = file.map(|file| &file.channels);
                    let channel = channels.and_then(|all| all.get(&message.header.channel_id));
                    if let Some(channel) = channel {
                        let data = message.data.clone();
                        latched.add(&channel.topic.name, &data, message);
                    }
                }
                Err(error) => unreadable.push(error),
            }
        }
        (latched.into_messages().collect(), unreadable)
    }
}
