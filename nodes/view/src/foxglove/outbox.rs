//! Messages that wait for one client: the newest of each channel, in order of arrival.

use bytes::Bytes;
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Mutex, MutexGuard, PoisonError},
};
use thiserror::Error;
use tokio::sync::Notify;

/// The most subscriptions per client: more than a layout shows.
pub(crate) const MOST_SUBSCRIPTIONS: usize = 256;
/// The most waiting messages per channel: enough for bursts such as a rollout's pictures or a node's log.
const DEPTH: usize = 64;
/// The most waiting bytes per channel besides its newest message: a few compressed pictures, or one raw image.
const BYTES: usize = 256 << 10;

/// A message, shared by all clients.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sample {
    /// When it was received \[ns\].
    pub log_time_ns: u64,
    /// CDR with its header.
    pub cdr: Bytes,
}

/// Why a subscription is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub(crate) enum SubscribeError {
    #[error("subscription {0} exists already")]
    Id(u32),
    /// A channel already has a subscription.
    #[error("channel {0} is subscribed to already")]
    Channel(u32),
    #[error("channel {0} does not exist")]
    Unknown(u32),
    #[error("a client may have {MOST_SUBSCRIPTIONS} subscriptions")]
    Most,
}

/// The waiting messages of a client. A full channel drops its oldest message.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    queues: Mutex<Queues>,
    filled: Notify,
}

#[derive(Debug, Default)]
struct Queues {
    by_channel: BTreeMap<u32, Queue>,
    /// The number of the last message, for the order of arrival.
    last: u64,
}

#[derive(Debug)]
struct Queue {
    subscription: u32,
    waiting: VecDeque<(u64, Sample)>,
    bytes: usize,
    dropped: u64,
}

impl Queue {
    fn pop(&mut self) -> Option<Sample> {
        let (_, sample) = self.waiting.pop_front()?;
        self.bytes -= sample.cdr.len();
        Some(sample)
    }
}

impl Outbox {
    /// no invariant spans the lock
    fn queues(&self) -> MutexGuard<'_, Queues> {
        self.queues.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Subscribes to a channel.
    ///
    /// # Errors
    /// The channel or the number is taken, or there are too many subscriptions.
    pub(crate) fn subscribe(&self, channel: u32, subscription: u32) -> Result<(), SubscribeError> {
        let by_channel = &mut self.queues().by_channel;
        if by_channel.contains_key(&channel) {
            return Err(SubscribeError::Channel(channel));
        }
        let mut others = by_channel.values();
        if others.any(|queue| queue.subscription == subscription) {
            return Err(SubscribeError::Id(subscription));
        }
        if by_channel.len() >= MOST_SUBSCRIPTIONS {
            return Err(SubscribeError::Most);
        }
        let queue = Queue {
            subscription,
            waiting: VecDeque::new(),
            bytes: 0,
            dropped: 0,
        };
        by_channel.insert(channel, queue);
        Ok(())
    }

    /// Ends a subscription, drops its messages and returns its channel.
    pub(crate) fn unsubscribe(&self, subscription: u32) -> Option<u32> {
        let by_channel = &mut self.queues().by_channel;
        let mut queues = by_channel.iter();
        let (&channel, _) = queues.find(|(_, queue)| queue.subscription == subscription)?;
        by_channel.remove(&channel);
        Some(channel)
    }

    /// Ends the subscription to a channel that has gone.
    pub(crate) fn remove(&self, channel: u32) {
        self.queues().by_channel.remove(&channel);
    }

    /// The subscribed channels.
    pub(crate) fn channels(&self) -> Vec<u32> {
        self.queues().by_channel.keys().copied().collect()
    }

    /// Adds a message of a channel. Returns how many older messages it displaced.
    pub(crate) fn push(&self, channel: u32, sample: Sample) -> u64 {
        let mut queues = self.queues();
        let queues = &mut *queues;
        let Some(queue) = queues.by_channel.get_mut(&channel) else {
            return 0;
        };
        queues.last += 1;
        queue.bytes += sample.cdr.len();
        queue.waiting.push_back((queues.last, sample));
        let mut dropped = 0;
        while queue.waiting.len() > DEPTH || (queue.waiting.len() > 1 && queue.bytes > BYTES) {
            queue.pop();
            dropped += 1;
        }
        queue.dropped += dropped;
        self.filled.notify_one();
        dropped
    }

    /// The next message with its subscription. Cancel safe.
    pub(crate) async fn next(&self) -> (u32, Sample) {
        loop {
            if let Some(next) = self.pop() {
                return next;
            }
            self.filled.notified().await;
        }
    }

    fn pop(&self) -> Option<(u32, Sample)> {
        let by_channel = &mut self.queues().by_channel;
        let queues = by_channel.values_mut();
        let waiting = queues.filter_map(|queue| Some((queue.waiting.front()?.0, queue)));
        let (_, queue) = waiting.min_by_key(|(number, _)| *number)?;
        Some((queue.subscription, queue.pop()?))
    }

    /// Dropped messages of each channel since the last call.
    pub(crate) fn take_losses(&self) -> Vec<(u32, u64)> {
        let by_channel = &mut self.queues().by_channel;
        let losses = by_channel
            .iter_mut()
            .map(|(channel, queue)| (*channel, std::mem::take(&mut queue.dropped)));
        losses.filter(|(_, dropped)| *dropped > 0).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::{collection::vec, prelude::*};

    fn sample(number: u64, bytes: usize) -> Sample {
        Sample {
            log_time_ns: number,
            cdr: vec![0; bytes].into(),
        }
    }

    fn all(outbox: &Outbox) -> Vec<(u32, u64)> {
        std::iter::from_fn(|| outbox.pop())
            .map(|(subscription, sample)| (subscription, sample.log_time_ns))
            .collect()
    }

    #[test]
    fn messages_leave_in_order_of_arrival() {
        let outbox = Outbox::default();
        outbox.subscribe(1, 10).unwrap();
        outbox.subscribe(2, 20).unwrap();
        for (channel, number) in [(2, 1), (1, 2), (3, 3), (2, 4)] {
            assert_eq!(outbox.push(channel, sample(number, 1)), 0);
        }
        assert_eq!(all(&outbox), [(20, 1), (10, 2), (20, 4)]);
    }

    #[test]
    fn full_channel_does_not_displace_others() {
        let outbox = Outbox::default();
        outbox.subscribe(1, 10).unwrap();
        outbox.subscribe(2, 20).unwrap();
        outbox.push(2, sample(0, 100));
        for number in 1..=1000 {
            outbox.push(1, sample(number, BYTES));
        }
        assert_eq!(all(&outbox), [(20, 0), (10, 1000)]);
        assert_eq!(outbox.take_losses(), [(1, 999)]);
        assert_eq!(outbox.take_losses(), []);
    }

    #[test]
    fn subscriptions_of_a_client_are_unique_and_bounded() {
        let outbox = Outbox::default();
        assert_eq!(outbox.subscribe(1, 7), Ok(()));
        assert_eq!(outbox.subscribe(1, 8), Err(SubscribeError::Channel(1)));
        assert_eq!(outbox.subscribe(2, 7), Err(SubscribeError::Id(7)));
        outbox.push(1, sample(1, 1));
        assert_eq!(outbox.unsubscribe(7), Some(1));
        assert_eq!(outbox.unsubscribe(7), None);
        assert_eq!(all(&outbox), []);
        for id in 0..256 {
            assert_eq!(outbox.subscribe(id, id), Ok(()));
        }
        assert_eq!(outbox.subscribe(256, 256), Err(SubscribeError::Most));
    }

    proptest! {
        /// For any sequence: bounded, the newest is never lost, and every message is either waiting or counted as lost.
        #[test]
        fn waiting_messages_are_bounded_and_drops_counted(
            pushes in vec((0u32..3, 0usize..BYTES), 1..200),
        ) {
            let outbox = Outbox::default();
            for channel in 0..3 {
                outbox.subscribe(channel, channel).unwrap();
            }
            let mut pushed = [0u64; 3];
            let mut newest = [None; 3];
            for (number, (channel, bytes)) in pushes.into_iter().enumerate() {
                outbox.push(channel, sample(number as u64, bytes));
                pushed[channel as usize] += 1;
                newest[channel as usize] = Some(number as u64);
            }
            let losses: BTreeMap<u32, u64> = outbox.take_losses().into_iter().collect();
            let queued: usize = outbox.queues().by_channel.values().map(|queue| queue.bytes).sum();
            prop_assert!(queued <= 3 * BYTES);
            let left = all(&outbox);
            prop_assert!(left.is_sorted_by_key(|(_, number)| *number));
            for channel in 0..3u32 {
                let of_it: Vec<u64> = left.iter().filter(|(id, _)| *id == channel).map(|(_, number)| *number).collect();
                let index = channel as usize;
                prop_assert!(of_it.len() <= DEPTH);
                prop_assert_eq!(of_it.last().copied(), newest[index]);
                prop_assert_eq!(of_it.len() as u64 + losses.get(&channel).copied().unwrap_or(0), pushed[index]);
            }
        }
    }
}
