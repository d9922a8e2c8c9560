//! A topic from Zenoh to this side's subscriptions.

use super::{Ends, Task};
use crate::{announcement::Subject, plan::Route};
use anyhow::{Result, anyhow};
use bytes::Bytes;
use std::{
    any::Any,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use wm_ros::{Durability, Gaps, Qos, RawPublisher};
use zenoh::{
    key_expr::OwnedKeyExpr,
    liveliness::LivelinessToken,
    sample::{Locality, Sample, SampleKind},
};
use zenoh_ext::{AdvancedSubscriberBuilderExt as _, HistoryConfig};

/// Samples that DDS may at least take at once: what comes after the network has been held up, comes in one burst.
const BURST: usize = 512;

/// How long this side's subscription is waited for to be connected, at most.
const CONNECTING: Duration = Duration::from_secs(2);

/// A topic on its way in. Its publisher on this side is there from the start, so that nodes see the topic; samples are
/// fetched for as long as nodes subscribe to it. A latched topic is followed from then on: to begin anew would fetch its
/// history, and publish it here, once more.
pub struct Incoming {
    stream: Arc<Stream>,
    type_name: String,
    task: Option<Task>,
    /// What this side's subscriptions are announced with.
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
            // How many a late subscriber is given is the publisher's word.
            Durability::TransientLocal => route.qos.depth,
        };
        let qos = Qos { depth, ..route.qos };
        let stream = Stream {
            key: ends.key_of(name)?,
            qos: route.qos,
            publisher: ends.node.raw_publisher(name, &route.type_name, qos)?,
            ends,
        };
        let mut incoming = Self {
            stream: Arc::new(stream),
            type_name: route.type_name.clone(),
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
        let Some(local) = route.local else {
            self.announced = None;
            if stream.qos.durability == Durability::Volatile {
                self.task = None;
            }
            return Ok(());
        };
        self.task
            .get_or_insert_with(|| Task::spawn(Arc::clone(stream).run()));
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
}

impl Stream {
    async fn run(self: Arc<Self>) {
        match self.subscribe().await {
            Ok(subscriber) => {
                let _held = subscriber;
                std::future::pending::<()>().await;
            }
            Err(error) => tracing::error!("{}: not carried: {error:#}", self.key),
        }
    }

    async fn subscribe(&self) -> Result<Box<dyn Any + Send + Sync>> {
        if self.qos.durability == Durability::Volatile {
            // Who sees a subscriber on the other side sends: what comes before this side's is connected would be lost. One
            // that asks for what no bridge can give is never connected.
            let connected = self.publisher.wait_for_subscribers(1);
            tokio::time::timeout(CONNECTING, connected).await.ok();
        }
        let failed = |error| anyhow!("cannot subscribe to {}: {error}", self.key);
        let (publisher, diagnostics) = (self.publisher.clone(), self.ends.node.diagnostics());
        let input = format!("zenoh {}", self.key);
        // Of publishers that number their samples, as `wm bridge` does for topics that are not latched.
        let gaps = Mutex::new(Gaps::default());
        let subscriber = self
            .ends
            .session
            .declare_subscriber(self.key.clone())
            .allowed_origin(Locality::Remote)
            .callback(move |sample: Sample| {
                if sample.kind() == SampleKind::Delete {
                    return;
                }
                diagnostics.received(&input);
                if let Some(source) = sample.source_info() {
                    let mut gaps = gaps.lock().unwrap_or_else(PoisonError::into_inner);
                    let missing = gaps.after(*source.source_id(), source.source_sn().into());
                    if missing > 0 {
                        diagnostics.count_drops(&format!("{input}: lost in transport"), missing);
                    }
                }
                let bytes = Bytes::from(sample.payload().to_bytes().into_owned());
                if let Err(error) = publisher.publish(bytes) {
                    tracing::debug!("{error}");
                    diagnostics.count_drop(&format!("{input}: not published"));
                }
            });
        if self.qos.durability == Durability::Volatile {
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
}
