//! Reads a bag into the state that the clients see.

use super::{Bag, FIT, STATIC_TRANSFORMS, TRANSFORMS};
use crate::shared::Shared;
use std::collections::BTreeMap;

/// Clients are notified after so many messages.
const STRIDE: usize = 500;

/// Reads the whole bag, and notifies the clients meanwhile.
pub(crate) fn read(bag: &Bag, shared: &Shared) {
    let mut unusable: BTreeMap<String, (u64, String)> = BTreeMap::new();
    let scene = [&*bag.camera_info, TRANSFORMS, STATIC_TRANSFORMS, FIT];
    let topics = bag.topics.keys().map(String::as_str).chain(scene);
    let messages = bag.reader.messages().only_topics(topics);
    for (number, message) in messages.enumerate() {
        let (topic, applied) = match message {
            Ok(message) => {
                let applied = bag.apply(&mut shared.known().state, &message);
                (message.topic.to_string(), applied)
            }
            Err(error) => ("(the bag)".to_owned(), Err(error.into())),
        };
        if let Err(error) = applied {
            let entry = unusable.entry(topic);
            entry.or_insert_with(|| (0, error.to_string())).0 += 1;
        }
        if number % STRIDE == 0 {
            shared.wake();
        }
    }
    for (topic, (number, reason)) in unusable {
        tracing::warn!("{topic}: {number} messages are skipped: {reason}");
    }
    shared.renew_status();
    shared.wake();
}
