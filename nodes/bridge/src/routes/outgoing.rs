//! A topic from publishers of this side to Zenoh.

use super::{Ends, ROUTING, Task};
use crate::{announcement::Subject, limiter::Limiter, plan::Route};
use anyhow::{Context as _, Result, anyhow};
use bytes::Bytes;
use std::{sync::Arc, time::Instant};
use wm_ros::{Durability, Qos, Reliability};
use zenoh::{
    Wait as _, key_expr::OwnedKeyExpr, liveliness::LivelinessToken, qos::CongestionControl,
    sample::Locality,
};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig, MissDetectionConfig,
};

/// The least size of the queue to the network; policy DropOldest.
const QUEUE: usize = 32;

pub(crate) struct OutgoingTopic {
    _task: Task,
    _token: LivelinessToken,
}

impl OutgoingTopic {
    /// Publishes the topic on Zenoh.
    ///
    /// # Errors
    /// Its name has no key expression, or the session is closed.
    pub(crate) async fn begin(ends: Arc<Ends>, name: &str, route: &Route) -> Result<Self> {
        let key = ends.key_of(name)?;
        let subject = Subject::Publisher(route.local.unwrap_or(route.qos));
        let publisher = publish(&ends, name, &key, route.qos).await?;
        let token = ends.announce(subject, &key, &route.type_name).await?;
        let stream = Stream {
            limiter: ends.settings.period(name).map(Limiter::new),
            ends,
            name: name.to_owned(),
            key,
            type_name: route.type_name.clone(),
            qos: Qos {
                depth: route.qos.depth.max(QUEUE),
                ..route.qos
            },
            publisher: Arc::new(publisher),
            start: Instant::now(),
            held_back: 0,
        };
        Ok(Self {
            _task: Task::spawn(stream.run()),
            _token: token,
        })
    }
}

async fn publish(
    ends: &Ends,
    name: &str,
    key: &OwnedKeyExpr,
    qos: Qos,
) -> Result<AdvancedPublisher<'static>> {
    // as in the real bridge: reliable publishers wait for the network instead of losing samples
    let is_blocking =
        qos.reliability == Reliability::Reliable && ends.settings.reliable_routes_blocking;
    let congestion_control = match is_blocking {
        true => CongestionControl::Block,
        false => CongestionControl::Drop,
    };
    let precedence = ends.settings.precedence(name);
    let publisher = ends
        .session
        .declare_publisher(key.clone())
        .congestion_control(congestion_control)
        .priority(precedence.priority)
        .express(precedence.is_express)
        .reliability(zenoh::qos::Reliability::Reliable)
        .allowed_destination(Locality::Remote)
        .advanced();
    let publisher = match qos.durability {
        // Zenoh drops silently: the other end detects loss by the numbers
        Durability::Volatile => {
            let numbered = publisher.sample_miss_detection(MissDetectionConfig::default());
            numbered.await
        }
        Durability::TransientLocal => {
            let samples = qos.depth.saturating_mul(ends.settings.cache_multiplier);
            let cache = CacheConfig::default().max_samples(samples);
            publisher.cache(cache).publisher_detection().await
        }
    };
    publisher.map_err(|error| anyhow!("cannot publish {key}: {error}"))
}

struct Stream {
    ends: Arc<Ends>,
    name: String,
    key: OwnedKeyExpr,
    type_name: String,
    qos: Qos,
    publisher: Arc<AdvancedPublisher<'static>>,
    limiter: Option<Limiter>,
    start: Instant,
    held_back: u64,
}

impl Stream {
    async fn run(mut self) {
        if let Err(error) = self.forward().await {
            tracing::error!("{}: no longer carried: {error:#}", self.name);
        }
    }

    /// Subscribes to the topic while it has subscribers on Zenoh. A latched topic is always subscribed to, so that late
    /// subscribers get its last samples.
    async fn forward(&mut self) -> Result<()> {
        let failed = |error| anyhow!("cannot watch the subscribers on Zenoh: {error}");
        let is_latched = self.qos.durability == Durability::TransientLocal;
        let publisher = Arc::clone(&self.publisher);
        let listener = publisher.matching_listener().await.map_err(failed)?;
        let mut is_heard = publisher
            .matching_status()
            .await
            .map_err(failed)?
            .matching();
        loop {
            while !is_heard && !is_latched {
                is_heard = listener.recv_async().await.map_err(failed)?.matching();
            }
            if !is_latched {
                // publishers of this side see a subscription once its samples arrive
                tokio::time::sleep(ROUTING).await;
            }
            let mut samples =
                self.ends
                    .node
                    .raw_subscription_to_others(&self.name, &self.type_name, self.qos)?;
            while is_heard || is_latched {
                tokio::select! {
                    status = listener.recv_async() => {
                        is_heard = status.map_err(failed)?.matching();
                    }
                    // sending is not cancelled: the next sample would overtake this one
                    sample = samples.recv() => match sample {
                        Some(sample) => self.carry(sample.message).await?,
                        None => return Ok(()),
                    },
                }
            }
        }
    }

    async fn carry(&mut self, sample: Bytes) -> Result<()> {
        if self.is_due() {
            self.send(sample).await?;
        }
        Ok(())
    }

    fn is_due(&mut self) -> bool {
        // the last state of a latched topic must arrive, even if it closely follows another
        if self.qos.durability == Durability::TransientLocal {
            return true;
        }
        let now = self.start.elapsed();
        let is_due = self
            .limiter
            .as_mut()
            .is_none_or(|limiter| limiter.admits(now));
        if !is_due {
            self.held_back += 1;
            let key = format!("{} held back by its highest frequency [total]", self.name);
            self.ends.node.diagnostics().set_value(&key, self.held_back);
        }
        is_due
    }

    async fn send(&self, sample: Bytes) -> Result<()> {
        let publisher = Arc::clone(&self.publisher);
        // a separate thread, since this blocks under congestion
        let put = tokio::task::spawn_blocking(move || publisher.put(sample).wait());
        let diagnostics = self.ends.node.diagnostics();
        match put.await.context("sending")? {
            Ok(()) => diagnostics.sent(&format!("zenoh {}", self.key)),
            Err(error) => {
                tracing::debug!("{}: {error}", self.name);
                diagnostics.count_drop(&format!("{}: not sent", self.name));
            }
        }
        Ok(())
    }
}
