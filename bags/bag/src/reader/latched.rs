//! What holds at a time of a bag.

use std::sync::Arc;

use super::{BagMessage, BagReader, StoredMessage};
use crate::{BagError, Latched, TopicInfo};

impl BagReader {
    /// The messages of latched topics that hold at this log time, in ns since the epoch: of each of them the last that was
    /// logged before, of `/tf_static` all that differ. `wants` selects topics. Reads the bag up to that time, without the
    /// chunks that hold no such topic.
    ///
    /// Gives also what could not be read.
    pub fn latched_before(
        &self,
        log_time_ns: u64,
        wants: impl Fn(&TopicInfo) -> bool,
    ) -> (Vec<BagMessage>, Vec<BagError>) {
        let topics = self.latched_topics(wants);
        let messages = self.messages().only_topics(topics);
        let (mut latched, mut unreadable) = (Latched::default(), Vec::new());
        for message in messages.ending_before(log_time_ns) {
            match message {
                Ok(message) => {
                    let data = message.data.clone();
                    latched.keep(&Arc::clone(&message.topic), &data, message);
                }
                Err(error) => unreadable.push(error),
            }
        }
        let messages = latched.into_messages().map(|(_, message)| message);
        (messages.collect(), unreadable)
    }

    /// The same as the files hold them, with the topic of each.
    pub(crate) fn stored_latched_before(
        &self,
        log_time_ns: u64,
        wants: impl Fn(&TopicInfo) -> bool,
    ) -> (Vec<(Arc<str>, StoredMessage)>, Vec<BagError>) {
        let topics = self.latched_topics(wants);
        let messages = self
            .stored_messages(|messages| messages.only_topics(topics).ending_before(log_time_ns));
        let (mut latched, mut unreadable) = (Latched::default(), Vec::new());
        for message in messages {
            match message {
                Ok(message) => {
                    let file = self.index.get(message.file);
                    let channel =
                        file.and_then(|file| file.channels.get(&message.header.channel_id));
                    if let Some(channel) = channel {
                        let data = message.data.clone();
                        latched.keep(&channel.topic.name, &data, message);
                    }
                }
                Err(error) => unreadable.push(error),
            }
        }
        (latched.into_messages().collect(), unreadable)
    }

    fn latched_topics(&self, wants: impl Fn(&TopicInfo) -> bool) -> Vec<Arc<str>> {
        let topics = self.topics().iter();
        let latched = topics.filter(|topic| topic.is_latched() && wants(topic));
        latched.map(|topic| Arc::clone(&topic.name)).collect()
    }
}
