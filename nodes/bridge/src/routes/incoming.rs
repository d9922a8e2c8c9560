//! A topic from Zenoh to subscriptions of this side.

use super::{Ends, ROUTING, Task};
use crate::{announcement::Subject, plan::Route};
use anyhow::{Result, anyhow};
use bytes::Bytes;
use std::{
    any::Any,
    collections::HashMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use wm_ros::{Durability, Gaps, Qos, RawPublisher};
use zenoh::{
    key_expr::OwnedKeyExpr,
    liveliness::LivelinessToken,
    sample::{Locality, Sample, SampleKind},
    time::{NTP64, TimestampId},
};
use zenoh_ext::{AdvancedSubscriberBuilderExt as _, HistoryConfig};

/// Samples that DDS must accept at once: after the network was blocked, they arrive in a burst.
const BURST: usize = 512;

/// The longest wait for the connection of this side's subscription.
const CONNECTING: Duration = Duration::from_secs(2);

/// Pauses before the history of a latched topic is requested again, until a sample arrives. The real bridge starts
/// reading a topic when it sees a subscriber on Zenoh. Samples sent at once may be lost ([`ROUTING`]), but stay in its
/// history.
const AGAIN: [Duration; 3] = [
    Duration::from_secs(1),
    Duration::from_secs(2),
    Duration::from_secs(4),
];

/// The most sources of a latched topic: more than the restarts that repeat samples.
const MOST_SOURCES: usize = 64;

/// An incoming topic. Its publisher on this side always exists, so that nodes see the topic. Samples are fetched while
/// nodes subscribe to it; of a latched topic from then on.
pub(crate) struct IncomingTopic {
    stream: Arc<Stream>,
    type_name: String,
    /// Whether another bridge publishes the topic.
    is_remote: bool,
    task: Option<Task>,
    /// The QoS with which this side's subscriptions are announced while samples are fetched. The real bridge sends
    /// nothing to a subscriber that was not announced, even if it is announced later.
    announced: Option<(Qos, LivelinessToken)>,
}

impl IncomingTopic {
    /// Publishes the topic on this side.
    ///
    /// # Errors
    /// Its name or type is invalid in ROS, or a side is closed.
    pub(crate) async fn begin(ends: Arc<Ends>, name: &str, route: &Route) -> Result<Self> {
        let depth = match route.qos.durability {
            Durability::Volatile => route.qos.depth.max(BURST),
            Durability::TransientLocal => route.qos.depth,
        };
        let qos = Qos { depth, ..route.qos };
        let stream = Stream {
            key: ends.key_of(name)?,
            qos: route.qos,
            publisher: ends.node.raw_publisher(name, &route.type_name, qos)?,
            ends,
            newest: Mutex::default(),
            has_come: AtomicBool::new(false),
        };
        let mut incoming = Self {
            stream: Arc::new(stream),
            type_name: route.type_name.clone(),
            is_remote: false,
            task: None,
            announced: None,
        };
        incoming.change(route).await?;
        Ok(incoming)
    }

    /// Starts or stops fetching samples.
    ///
    /// # Errors
    /// The session is closed.
    pub(crate) async fn change(&mut self, route: &Route) -> Result<()> {
        let stream = &self.stream;
        let is_latched = stream.qos.durability == Durability::TransientLocal;
        let is_new = route.is_remote && !self.is_remote;
        self.is_remote = route.is_remote;
        let is_due = match &self.task {
            None => route.local.is_some(),
            // the other bridge's history is fetched when there is a route to it; until then the previous subscription
            // continues
            Some(_) => is_latched && is_new,
        };
        if is_due {
            let before = self.task.take();
            self.task = Some(Task::spawn(Arc::clone(stream).run(is_new, before)));
        }
        let Some(local) = route.local else {
            if !is_latched {
                self.task = None;
                self.announced = None;
            }
            return Ok(());
        };
        if self.announced.as_ref().is_none_or(|(qos, _)| *qos != local) {
            let subject = Subject::Subscriber(local);
            let token = stream.ends.announce(subject, &stream.key, &self.type_name);
            self.announced = Some((local, token.await?));
        }
        Ok(())
    }
}

struct Stream {
    ends: Arc<Ends>,
    key: OwnedKeyExpr,
    qos: Qos,
    publisher: RawPublisher,
    /// Of a latched topic: when the newest sample of each source was sent.
    newest: Mutex<HashMap<TimestampId, NTP64>>,
    has_come: AtomicBool,
}

impl Stream {
    async fn run(self: Arc<Self>, is_new: bool, before: Option<Task>) {
        if is_new && self.qos.durability == Durability::TransientLocal {
            tokio::time::sleep(ROUTING).await;
        }
        if let Err(error) = self.fetch(before).await {
            tracing::error!("{}: not carried: {error:#}", self.key);
        }
    }

    async fn fetch(self: &Arc<Self>, before: Option<Task>) -> Result<()> {
        let mut _held = Arc::clone(self).subscribe().await?;
        drop(before);
        if self.qos.durability == Durability::TransientLocal {
            for pause in AGAIN {
                tokio::time::sleep(pause).await;
                if self.has_come.load(Ordering::Relaxed) {
                    break;
                }
                // drops the previous subscription when the new one exists
                _held = Arc::clone(self).subscribe().await?;
            }
        }
        std::future::pending().await
    }

    async fn subscribe(self: Arc<Self>) -> Result<Box<dyn Any + Send + Sync>> {
        let is_latched = self.qos.durability == Durability::TransientLocal;
        if !is_latched {
            // The other side sends as soon as it sees a subscriber: samples before this side's subscription is
            // connected would be lost. A subscription that requests more than a bridge can offer is never connected.
            let connected = self.publisher.wait_for_subscribers(1);
            tokio::time::timeout(CONNECTING, connected).await.ok();
        }
        let failed = |error| anyhow!("cannot subscribe to {}: {error}", self.key);
        let input = format!("zenoh {}", self.key);
        // for publishers that number their samples, as `wm bridge` does for topics that are not latched
        let gaps = Mutex::new(Gaps::default());
        let stream = Arc::clone(&self);
        let subscriber = self
            .ends
            .session
            .declare_subscriber(self.key.clone())
            .allowed_origin(Locality::Remote)
            .callback(move |sample: Sample| match is_latched {
                true => stream.take_latched(&sample, &input),
                false => {
                    if let Some(source) = sample.source_info() {
                        let sequence = source.source_sn().into();
                        let missing = lock(&gaps).after(*source.source_id(), sequence);
                        if missing > 0 {
                            let diagnostics = stream.ends.node.diagnostics();
                            diagnostics
                                .count_drops(&format!("{input}: lost in transport"), missing);
                        }
                    }
                    stream.take(&sample, &input);
                }
            });
        if !is_latched {
            return Ok(Box::new(subscriber.await.map_err(failed)?));
        }
        let history = HistoryConfig::default()
            .detect_late_publishers()
            .max_samples(self.qos.depth);
        let subscriber = subscriber
            .advanced()
            .history(history)
            .query_timeout(self.ends.settings.queries_timeout)
            .await;
        Ok(Box::new(subscriber.map_err(failed)?))
    }

    /// Takes a sample unless the previous subscription has taken it.
    fn take_latched(&self, sample: &Sample, input: &str) {
        let mut newest = lock(&self.newest);
        if let Some(stamp) = sample.timestamp() {
            let (source, time) = (*stamp.get_id(), *stamp.get_time());
            if newest.get(&source).is_some_and(|last| *last >= time) {
                return;
            }
            if newest.len() >= MOST_SOURCES && !newest.contains_key(&source) {
                newest.clear();
            }
            newest.insert(source, time);
        }
        self.take(sample, input);
    }

    fn take(&self, sample: &Sample, input: &str) {
        if sample.kind() == SampleKind::Delete {
            return;
        }
        self.has_come.store(true, Ordering::Relaxed);
        let diagnostics = self.ends.node.diagnostics();
        diagnostics.received(input);
        let bytes = Bytes::from(sample.payload().to_bytes().into_owned());
        if let Err(error) = self.publisher.publish(bytes) {
            tracing::debug!("{error}");
            diagnostics.count_drop(&format!("{input}: not published"));
        }
    }
}

/// no invariant spans these locks
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
