//! A topic from Zenoh to this side's subscriptions.

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

/// Samples that DDS may at least take at once: what comes after the network has been held up, comes in one burst.
const BURST: usize = 512;

/// How long this side's subscription is waited for to be connected, at most.
const CONNECTING: Duration = Duration::from_secs(2);

/// Pauses before the history of a latched topic is requested again, until a sample arrives. The real bridge starts to read a
/// topic when it sees a subscriber on Zenoh. What it sends at once may be lost ([`ROUTING`]), but stays in its history.
const AGAIN: [Duration; 3] = [
    Duration::from_secs(1),
    Duration::from_secs(2),
    Duration::from_secs(4),
];

/// Sources of a latched topic that are remembered; beyond that it has met more restarts than anybody repeats samples over.
const MOST_SOURCES: usize = 64;

/// A topic on its way in. Its publisher on this side is there from the start, so that nodes see the topic; samples are
/// fetched for as long as nodes subscribe to it. A latched topic is followed from then on.
pub struct Incoming {
    stream: Arc<Stream>,
    type_name: String,
    /// Whether another bridge publishes the topic.
    is_remote: bool,
    task: Option<Task>,
    /// What this side's subscriptions are announced with, for as long as samples are fetched: the real bridge sends nothing
    /// to a subscriber on Zenoh that it was not told of, and does not begin again when it is.
    announced: Option<(Qos, LivelinessToken)>,
}

impl Incoming {
    /// Publishes the topic on this side.
    ///
    /// # Errors
    /// Its name or type is none of ROS, or one of the sides is closed.
    pub async fn begin(ends: Arc<Ends>, name: &str, route: &Route) -> Result<Self> {
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

    /// Begins or ends to fetch samples.
    ///
    /// # Errors
    /// The session is closed.
    pub async fn change(&mut self, route: &Route) -> Result<()> {
        let stream = &self.stream;
        let is_latched = stream.qos.durability == Durability::TransientLocal;
        let is_new = route.is_remote && !self.is_remote;
        self.is_remote = route.is_remote;
        let is_due = match &self.task {
            None => route.local.is_some(),
            // What another bridge holds is fetched when there is a way to it. Until then the subscription before goes on.
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
    /// Of a latched topic, when the newest sample of each source was sent.
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
                // The one before is let go of when this one is there.
                _held = Arc::clone(self).subscribe().await?;
            }
        }
        std::future::pending().await
    }

    async fn subscribe(self: Arc<Self>) -> Result<Box<dyn Any + Send + Sync>> {
        let is_latched = self.qos.durability == Durability::TransientLocal;
        if !is_latched {
            // Who sees a subscriber on the other side sends: what comes before this side's is connected would be lost. One
            // that asks for what no bridge can give is never connected.
            let connected = self.publisher.wait_for_subscribers(1);
            tokio::time::timeout(CONNECTING, connected).await.ok();
        }
        let failed = |error| anyhow!("cannot subscribe to {}: {error}", self.key);
        let input = format!("zenoh {}", self.key);
        // Of publishers that number their samples, as `wm bridge` does for topics that are not latched.
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

    /// Takes a sample that the subscription before this one has not taken.
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

/// A panic elsewhere leaves nothing half done under these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
