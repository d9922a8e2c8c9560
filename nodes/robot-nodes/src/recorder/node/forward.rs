//! A topic's messages from its subscription to the bag's queue.

use anyhow::Result;
use bytes::Bytes;
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};
use tokio::sync::watch;
use wm_bag::{QosProfile, Schema};
use wm_ros::{Diagnostics, RawSubscription, Received};

use crate::recorder::{
    lookup::Lookup,
    losses::Loss,
    writer::{Entry, Queue},
};

/// Most bytes of messages that wait for the definition of their type.
const MOST_WAITING: usize = 64 << 20;

/// A topic, for the bag; it precedes the topic's messages.
pub(super) struct Announcement {
    pub topic: Arc<str>,
    pub type_name: String,
    /// Possible definitions of the publisher.
    pub candidates: Vec<Schema>,
    pub qos: QosProfile,
}

impl From<Announcement> for Entry {
    fn from(announcement: Announcement) -> Self {
        Self::Topic {
            name: announcement.topic,
            type_name: announcement.type_name,
            candidates: announcement.candidates,
            qos: announcement.qos,
        }
    }
}

/// Forwards a topic's messages to the bag's queue.
pub(super) struct Forward {
    pub topic: Arc<str>,
    pub queue: Queue,
    pub is_paused: Arc<AtomicBool>,
    pub loss: Arc<Loss>,
    pub diagnostics: Diagnostics,
}

impl Forward {
    /// Forwards until the shutdown, or until `end` is true. With a `lookup`, messages first wait for its result.
    pub async fn run(
        self,
        mut announcement: Announcement,
        lookup: Option<Lookup>,
        mut subscription: RawSubscription,
        mut end: watch::Receiver<bool>,
    ) -> Result<()> {
        let mut waiting = Vec::new();
        if let Some(lookup) = lookup {
            let mut bytes = 0;
            let candidates = lookup.candidates();
            tokio::pin!(candidates);
            announcement.candidates = loop {
                tokio::select! {
                    biased;
                    candidates = &mut candidates => break candidates,
                    _ = end.wait_for(|is_over| *is_over) => break Vec::new(),
                    Some(received) = subscription.recv(), if bytes < MOST_WAITING => {
                        bytes += received.message.len();
                        waiting.push(received);
                    }
                }
            };
        }
        self.queue.offer(announcement.into())?;
        for received in waiting {
            self.offer(received)?;
        }
        // After the end, the messages that still wait are forwarded too.
        loop {
            let received = tokio::select! {
                biased;
                received = subscription.recv() => received,
                _ = end.wait_for(|is_over| *is_over) => None,
            };
            let Some(received) = received.or_else(|| subscription.try_recv()) else {
                break;
            };
            self.offer(received)?;
        }
        self.loss.count_queues(subscription.dropped());
        self.loss.count_undecodable(subscription.undecodable());
        self.loss.count_missing(subscription.lost());
        Ok(())
    }

    fn offer(&self, received: Received<Bytes>) -> Result<()> {
        // Messages during a pause are no loss.
        if self.is_paused.load(Ordering::Relaxed) {
            return Ok(());
        }
        let entry = Entry::Message {
            topic: Arc::clone(&self.topic),
            // The bag's format has no times before 1970.
            log_time_ns: u64::try_from(received.received.to_nanos()).unwrap_or(0),
            data: received.message,
        };
        if !self.queue.offer(entry)? {
            self.loss.count_queues(1);
            self.diagnostics
                .count_drop(&format!("{}: cache full", self.topic));
        }
        Ok(())
    }
}
