//! The messages of a channel, for its subscribers.

use super::{
    channel::Channel,
    outbox::{Outbox, Sample},
};
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use wm_ros::PublisherId;

/// The most latching publishers: far more than a topic has.
const MOST_LATCHING: usize = 16;
/// How long the DDS subscription stays without clients. A changed layout subscribes again at once, and a client that
/// toggles makes no subscription each time.
const LINGER: Duration = Duration::from_secs(2);

/// A subscribed channel.
#[derive(Debug)]
pub(crate) struct Feed {
    channel: Arc<Channel>,
    audience: Mutex<Audience>,
}

#[derive(Debug, Default)]
struct Audience {
    outboxes: Vec<Arc<Outbox>>,
    /// The newest message of each latching publisher, oldest first, for late clients.
    latched: Vec<(PublisherId, Sample)>,
    /// When the next message may be sent, if the rate is limited.
    due: Option<Instant>,
    /// Since when there are no clients.
    deserted: Option<Instant>,
}

impl Feed {
    pub(crate) fn new(channel: Arc<Channel>) -> Self {
        Self {
            channel,
            audience: Mutex::default(),
        }
    }

    pub(crate) fn channel(&self) -> &Channel {
        &self.channel
    }

    /// no invariant spans the lock
    fn audience(&self) -> MutexGuard<'_, Audience> {
        self.audience.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a client and sends it the latched messages.
    pub(crate) fn join(&self, outbox: &Arc<Outbox>) {
        let mut audience = self.audience();
        for (_, sample) in &audience.latched {
            outbox.push(self.channel.id, sample.clone());
        }
        audience.outboxes.push(Arc::clone(outbox));
        audience.deserted = None;
    }

    pub(crate) fn leave(&self, outbox: &Arc<Outbox>, now: Instant) {
        let mut audience = self.audience();
        audience
            .outboxes
            .retain(|other| !Arc::ptr_eq(other, outbox));
        if audience.outboxes.is_empty() {
            audience.deserted = Some(now);
        }
    }

    /// Whether it had no clients for [`LINGER`].
    pub(crate) fn is_deserted(&self, now: Instant) -> bool {
        let since = self.audience().deserted;
        since.is_some_and(|since| now.saturating_duration_since(since) >= LINGER)
    }

    /// Sends a message to all clients. Returns how many older messages it displaced.
    pub(crate) fn forward(&self, publisher: PublisherId, sample: &Sample, now: Instant) -> u64 {
        let audience = &mut *self.audience();
        if self.channel.latches() {
            // latched messages stay valid, so none is skipped
            audience.remember(publisher, sample);
        } else if let Some(period) = self.channel.period
            && !audience.is_due(period, now)
        {
            return 0;
        }
        let outboxes = audience.outboxes.iter();
        outboxes
            .map(|outbox| outbox.push(self.channel.id, sample.clone()))
            .sum()
    }
}

impl Audience {
    fn remember(&mut self, publisher: PublisherId, sample: &Sample) {
        self.latched.retain(|(other, _)| *other != publisher);
        if self.latched.len() >= MOST_LATCHING {
            self.latched.remove(0);
        }
        self.latched.push((publisher, sample.clone()));
    }

    /// Whether a message may be sent: on average one per `period`.
    fn is_due(&mut self, period: Duration, now: Instant) -> bool {
        let due = self.due.unwrap_or(now);
        if now < due {
            return false;
        }
        // catches up delays below a period, so that 10 Hz of 30 are 10 and not 7.5
        let is_late = now.duration_since(due) >= period;
        let from = if is_late { now } else { due };
        self.due = from.checked_add(period);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::{super::channel::tests::channel, *};

    const A: PublisherId = PublisherId([1; 16]);
    const B: PublisherId = PublisherId([2; 16]);

    fn sample(number: u64) -> Sample {
        Sample {
            log_time_ns: number,
            cdr: vec![0; 4].into(),
        }
    }

    async fn received(outbox: &Outbox) -> Vec<u64> {
        let mut numbers = Vec::new();
        let limit = Duration::from_millis(10);
        while let Ok((_, sample)) = tokio::time::timeout(limit, outbox.next()).await {
            numbers.push(sample.log_time_ns);
        }
        numbers
    }

    fn client() -> Arc<Outbox> {
        let outbox = Arc::new(Outbox::default());
        outbox.subscribe(1, 1).unwrap();
        outbox
    }

    #[tokio::test]
    async fn late_client_gets_only_latched_messages() {
        let now = Instant::now();
        for (latches, expected) in [(true, vec![2, 3]), (false, vec![])] {
            let feed = Feed::new(Arc::new(channel("/tf_static", None, latches)));
            let first = client();
            feed.join(&first);
            for (publisher, number) in [(A, 1), (B, 2), (A, 3)] {
                feed.forward(publisher, &sample(number), now);
            }
            let late = client();
            feed.join(&late);
            assert_eq!(received(&first).await, [1, 2, 3]);
            assert_eq!(received(&late).await, expected);
        }
    }

    #[tokio::test]
    async fn rate_limits_all_but_latched_messages() {
        let start = Instant::now();
        let period = Some(Duration::from_millis(100));
        for (latches, expected) in [(true, 31), (false, 11)] {
            let feed = Feed::new(Arc::new(channel("/camera", period, latches)));
            let outbox = client();
            feed.join(&outbox);
            for number in 0..31 {
                let at = start + Duration::from_secs_f64(number as f64 / 30.0);
                feed.forward(A, &sample(number), at);
            }
            assert_eq!(received(&outbox).await.len(), expected);
        }
    }

    #[test]
    fn feed_ends_some_time_after_its_last_client() {
        let now = Instant::now();
        let feed = Feed::new(Arc::new(channel("/a", None, false)));
        let (first, second) = (client(), client());
        feed.join(&first);
        feed.join(&second);
        feed.leave(&first, now);
        assert!(!feed.is_deserted(now + 2 * LINGER));
        feed.leave(&second, now);
        assert!(!feed.is_deserted(now + LINGER / 2));
        assert!(feed.is_deserted(now + LINGER));
        feed.join(&first);
        assert!(!feed.is_deserted(now + 2 * LINGER));
    }
}
