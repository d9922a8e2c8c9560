//! Connects the graph and the clients.

use super::{
    channel::Channels,
    feed::Feed,
    message::{ServerMessage, Subscription},
    offer::Offer,
    outbox::{Outbox, Sample, SubscribeError},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};
use tokio::{sync::watch, task::AbortHandle};
use wm_bag::definitions;
use wm_ros::{Node, Qos};

/// Best effort, so that no publisher waits for a viewer; deep enough for bursts.
const QOS: Qos = Qos::best_effort(64);
/// For latched topics: a lost message would be missing until the next one.
const LATCHED: Qos = Qos::reliable(64);
/// Largest message sent \[byte\]: a raw image of 4K has 25 MB.
pub(crate) const MAX_MESSAGE: usize = 64 << 20;
/// The most channels per message: a definition has some kilobytes.
const BATCH: usize = 64;
/// How often changes of the graph are applied, and feeds without clients end.
const LOOK: Duration = Duration::from_millis(250);

/// Drop reasons in the node's diagnostics.
const SLOW: &str = "message for a Foxglove client that is slow";
const LARGE: &str = "message too large for Foxglove clients";

/// The channels and their clients.
pub(crate) struct Hub {
    node: Node,
    offer: Offer,
    prefixes: Vec<PathBuf>,
    session: String,
    known: Mutex<HubState>,
    /// Notifies of changed channels.
    changes: watch::Sender<()>,
    has_warned: AtomicBool,
}

#[derive(Default)]
struct HubState {
    channels: Channels,
    feeds: BTreeMap<u32, ActiveFeed>,
}

/// A feed with its task.
struct ActiveFeed {
    feed: Arc<Feed>,
    task: AbortHandle,
}

impl Drop for ActiveFeed {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Hub {
    pub(crate) fn new(node: &Node, offer: Offer) -> Arc<Self> {
        Arc::new(Self {
            node: node.clone(),
            offer,
            prefixes: definitions::prefixes(),
            session: format!("{:032x}", rand::random::<u128>()),
            known: Mutex::default(),
            changes: watch::Sender::new(()),
            has_warned: AtomicBool::new(false),
        })
    }

    /// each call leaves it consistent, and a panic ends the process
    fn known(&self) -> MutexGuard<'_, HubState> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows the graph until the node ends.
    pub(crate) async fn look(self: Arc<Self>) {
        let mut graph = self.node.graph_changes();
        graph.mark_changed();
        let mut ticks = tokio::time::interval(LOOK);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            // an error means that the node ends
            if graph.has_changed().unwrap_or(false) {
                graph.mark_unchanged();
                self.update();
            }
            let now = Instant::now();
            let feeds = &mut self.known().feeds;
            feeds.retain(|_, running| !running.feed.is_deserted(now));
        }
    }

    fn update(&self) {
        let topics = self.node.topics();
        let mut known = self.known();
        let define = |type_name: &str| definitions::definition(type_name, &self.prefixes);
        let (gone, has_changed) = known.channels.update(&topics, &self.offer, define);
        for id in gone {
            known.feeds.remove(&id);
        }
        drop(known);
        if has_changed {
            self.changes.send_replace(());
        }
    }

    /// The first message of each client.
    pub(crate) fn server_info(&self) -> String {
        ServerMessage::server_info(&self.session).text()
    }

    /// Logs once that a web application was refused, since its user cannot see why.
    pub(crate) fn warn_of_origin(&self, origin: &str) {
        if !self.has_warned.swap(true, Ordering::Relaxed) {
            tracing::warn!(
                "a viewer of the origin {origin:?} is refused; if it is yours, list it in the parameter foxglove_origins"
            );
        }
    }

    /// Adds a client, which leaves when it is dropped.
    pub(crate) fn guest(self: &Arc<Self>) -> Guest {
        Guest {
            hub: Arc::clone(self),
            outbox: Arc::default(),
        }
    }
}

/// The channels that a client knows.
pub(crate) struct News {
    hub: Arc<Hub>,
    outbox: Arc<Outbox>,
    advertised: BTreeSet<u32>,
    changes: watch::Receiver<()>,
    is_first: bool,
}

impl News {
    /// Waits for changed channels. Cancel safe.
    pub(crate) async fn changed(&mut self) {
        if self.changes.changed().await.is_err() {
            // the hub and the node have ended
            std::future::pending::<()>().await;
        }
    }

    /// Messages about changed channels since the last call. The first call announces the existing channels, even if
    /// there are none, as the protocol requires.
    pub(crate) fn take(&mut self) -> Vec<String> {
        let known = self.hub.known();
        let there: BTreeSet<u32> = known.channels.iter().map(|channel| channel.id).collect();
        let gone: Vec<u32> = self.advertised.difference(&there).copied().collect();
        let mut news = Vec::new();
        if !gone.is_empty() {
            for id in &gone {
                self.outbox.remove(*id);
            }
            news.push(ServerMessage::Unadvertise { channel_ids: &gone }.text());
        }
        let new = known.channels.iter();
        let new = new.filter(|channel| !self.advertised.contains(&channel.id));
        let new: Vec<_> = new.collect();
        for batch in new.chunks(BATCH) {
            let channels = batch.iter().map(|channel| channel.advertised()).collect();
            news.push(ServerMessage::Advertise { channels }.text());
        }
        if std::mem::take(&mut self.is_first) && new.is_empty() {
            let channels = Vec::new();
            news.push(ServerMessage::Advertise { channels }.text());
        }
        self.advertised = there;
        news
    }
}

/// A client of the hub.
pub(crate) struct Guest {
    hub: Arc<Hub>,
    outbox: Arc<Outbox>,
}

impl Guest {
    pub(crate) fn news(&self) -> News {
        News {
            hub: Arc::clone(&self.hub),
            outbox: Arc::clone(&self.outbox),
            advertised: BTreeSet::new(),
            changes: self.hub.changes.subscribe(),
            is_first: true,
        }
    }

    /// The next message with its subscription. Cancel safe.
    pub(crate) async fn next(&self) -> (u32, Sample) {
        self.outbox.next().await
    }

    /// Messages dropped since the last call, as text.
    pub(crate) fn losses(&self) -> Option<String> {
        const NAMED: usize = 4;
        let mut losses = self.outbox.take_losses();
        losses.sort_by_key(|(_, number)| std::cmp::Reverse(*number));
        let all: u64 = losses.iter().map(|(_, number)| number).sum();
        let known = self.hub.known();
        let topics: Vec<&str> = losses
            .iter()
            .filter_map(|(id, _)| Some(&*known.channels.get(*id)?.topic))
            .take(NAMED)
            .collect();
        (all > 0).then(|| {
            format!(
                "this connection is too slow: {all} messages were dropped, most of {}",
                topics.join(", ")
            )
        })
    }

    /// Subscribes to a channel.
    ///
    /// # Errors
    /// The channel does not exist, or the client may not subscribe.
    pub(crate) fn subscribe(&self, asked: Subscription) -> Result<(), SubscribeError> {
        let Subscription { id, channel_id } = asked;
        let mut known = self.hub.known();
        let channel = known.channels.get(channel_id);
        let channel = Arc::clone(channel.ok_or(SubscribeError::Unknown(channel_id))?);
        self.outbox.subscribe(channel_id, id)?;
        let running = known.feeds.entry(channel_id).or_insert_with(|| {
            let feed = Arc::new(Feed::new(channel));
            let task = tokio::spawn(run(self.hub.node.clone(), Arc::clone(&feed)));
            let task = task.abort_handle();
            ActiveFeed { feed, task }
        });
        running.feed.join(&self.outbox);
        Ok(())
    }

    /// Ends a subscription. Unknown ones are ignored: the channel may have just gone.
    pub(crate) fn unsubscribe(&self, subscription: u32) {
        if let Some(channel) = self.outbox.unsubscribe(subscription) {
            self.leave(channel);
        }
    }

    fn leave(&self, channel: u32) {
        if let Some(running) = self.hub.known().feeds.get(&channel) {
            running.feed.leave(&self.outbox, Instant::now());
        }
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        for channel in self.outbox.channels() {
            self.leave(channel);
        }
    }
}

/// Subscribes to a channel in DDS, and forwards its messages until it is aborted.
async fn run(node: Node, feed: Arc<Feed>) {
    let channel = feed.channel();
    let (topic, type_name) = (&channel.topic, &channel.type_name);
    let subscribed = match channel.latches() {
        true => node.raw_subscription_to_any(topic, type_name, LATCHED),
        false => node.raw_subscription_catching_up(topic, type_name, QOS),
    };
    let mut subscription = match subscribed {
        Ok(subscription) => subscription,
        // DDS allows names that ROS does not
        Err(error) => return tracing::warn!("{} cannot be shown: {error}", channel.topic),
    };
    while let Some(received) = subscription.recv().await {
        let sample = Sample {
            // a clock set before 1970
            log_time_ns: u64::try_from(received.received.to_nanos()).unwrap_or(0),
            cdr: received.message,
        };
        if sample.cdr.len() > MAX_MESSAGE {
            node.diagnostics().count_skipped(LARGE, 1);
            continue;
        }
        let left_out = feed.forward(received.publisher, &sample, received.at);
        if left_out > 0 {
            node.diagnostics().count_skipped(SLOW, left_out);
        }
    }
}
