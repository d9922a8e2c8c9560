//! The way of a topic's messages from its subscription to the bag's thread.

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

/// Messages that may wait for the definition of their type \[byte\].
const MOST_HELD: usize = 64 << 20;

/// What the bag is to know of a topic ahead of its messages.
pub(super) struct Announcement {
    pub topic: Arc<str>,
    pub type_name: String,
    /// The definitions that may be its publisher's.
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

/// Takes a topic's messages to the bag's thread.
pub(super) struct Forward {
    pub topic: Arc<str>,
    pub queue: Queue,
    pub is_paused: Arc<AtomicBool>,
    pub loss: Arc<Loss>,
    pub diagnostics: Diagnostics,
}

impl Forward {
    /// Until the shutdown, or until it is over. With a `lookup`, messages wait until the definition of their type is found,
    /// or cannot be.
    pub async fn run(
        self,
        mut announcement: Announcement,
        lookup: Option<Lookup>,
        mut subscription: RawSubscription,
        mut over: watch::Receiver<bool>,
    ) -> Result<()> {
        let mut held = Vec::new();
        if let Some(lookup) = lookup {
            let mut bytes = 0;
            let candidates = lookup.candidates();
            tokio::pin!(candidates);
            announcement.candidates = loop {
                tokio::select! {
                    biased;
                    candidates = &mut candidates => break candidates,
                    _ = over.wait_for(|over| *over) => break Vec::new(),
                    Some(received) = subscription.recv(), if bytes < MOST_HELD => {
                        bytes += received.message.len();
                        held.push(received);
                    }
                }
            };
        }
        self.queue.offer(announcement.into())?;
        for received in held {
            self.offer(received)?;
        }
        // after that, what still waits
        loop {
            let received = tokio::select! {
                biased;
                received = subscription.recv() => received,
                _ = over.wait_for(|over| *over) => None,
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
        // no loss: it was asked for
        if self.is_paused.load(Ordering::Relaxed) {
            return Ok(());
        }
        let entry = Entry::Message {
            topic: Arc::clone(&self.topic),
            // A clock before 1970 has no such number.
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
