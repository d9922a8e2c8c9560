//! A service on Zenoh for clients of this side.

use super::{Ends, OPEN_CALLS, ROUTING, Task};
use crate::{announcement::Subject, plan::Route, request_header::RequestHeader};
use anyhow::{Context as _, Result, anyhow, bail};
use bytes::Bytes;
use std::sync::Arc;
use tokio::sync::Semaphore;
use wm_ros::RawCall;
use zenoh::{
    key_expr::OwnedKeyExpr, liveliness::LivelinessToken, query::Querier, sample::Locality,
};

/// A service on Zenoh. This side serves it only while another bridge announces it: a client of a server without replies
/// would wait forever.
pub(crate) struct RemoteService {
    ends: Arc<Ends>,
    name: String,
    key: OwnedKeyExpr,
    type_name: String,
    serving: Option<Task>,
    token: Option<LivelinessToken>,
}

impl RemoteService {
    /// Serves the service on this side if it exists.
    ///
    /// # Errors
    /// Its name has no key expression, or the session is closed.
    pub(crate) async fn begin(ends: Arc<Ends>, name: &str, route: &Route) -> Result<Self> {
        let mut called = Self {
            key: ends.key_of(name)?,
            ends,
            name: name.to_owned(),
            type_name: route.type_name.clone(),
            serving: None,
            token: None,
        };
        called.change(route).await?;
        Ok(called)
    }

    /// Starts or stops serving and announcing.
    ///
    /// # Errors
    /// The session is closed.
    pub(crate) async fn change(&mut self, route: &Route) -> Result<()> {
        self.serving = match (self.serving.take(), route.is_remote) {
            (_, false) => None,
            (Some(serving), true) => Some(serving),
            (None, true) => {
                let caller = Caller::new(Arc::clone(&self.ends), self.key.clone()).await?;
                let (name, type_name) = (self.name.clone(), self.type_name.clone());
                Some(Task::spawn(async move {
                    if let Err(error) = serve(Arc::new(caller), &name, &type_name).await {
                        tracing::error!("{name}: not served: {error:#}");
                    }
                }))
            }
        };
        self.token = match (self.token.take(), route.local) {
            (_, None) => None,
            (Some(token), Some(_)) => Some(token),
            (None, Some(_)) => Some(
                self.ends
                    .announce(Subject::Client, &self.key, &self.type_name)
                    .await?,
            ),
        };
        Ok(())
    }
}

/// Clients of this side see the service once their calls arrive.
async fn serve(caller: Arc<Caller>, name: &str, type_name: &str) -> Result<()> {
    caller.reach().await?;
    tokio::time::sleep(ROUTING).await;
    let node = &caller.ends.node;
    let mut service = node.raw_service_for_others(name, type_name)?;
    let places = Arc::new(Semaphore::new(OPEN_CALLS));
    while let Some(call) = service.recv().await {
        // the service's own queue is bounded, and drops the oldest call
        let place = Arc::clone(&places).acquire_owned().await?;
        let caller = Arc::clone(&caller);
        tokio::spawn(async move {
            if let Err(error) = caller.carry(call).await {
                let key = &caller.key;
                // ROS cannot report this to the client, which waits until its timeout
                tracing::warn!("a call of {key} is not answered: {error:#}");
                let diagnostics = caller.ends.node.diagnostics();
                diagnostics.count_drop(&format!("calls of zenoh {key}: not answered"));
            }
            drop(place);
        });
    }
    Ok(())
}

struct Caller {
    ends: Arc<Ends>,
    key: OwnedKeyExpr,
    querier: Querier<'static>,
}

impl Caller {
    async fn new(ends: Arc<Ends>, key: OwnedKeyExpr) -> Result<Self> {
        let querier = ends
            .session
            .declare_querier(key.clone())
            .allowed_destination(Locality::Remote)
            .timeout(ends.settings.queries_timeout)
            .await
            .map_err(|error| anyhow!("cannot call {key}: {error}"))?;
        Ok(Self { ends, key, querier })
    }

    async fn carry(&self, mut call: RawCall) -> Result<()> {
        let header = RequestHeader::of_call(call.id());
        let replies = self
            .querier
            .get()
            .payload(std::mem::take(&mut call.request))
            .attachment(header.to_bytes().to_vec())
            .await
            .map_err(|error| anyhow!("{error}"))?;
        let reply = replies.recv_async().await;
        // Zenoh itself replies when the time is over
        let reply = reply.ok().context("the other side did not answer")?;
        match reply.result() {
            Ok(sample) => {
                let answer = Bytes::from(sample.payload().to_bytes().into_owned());
                Ok(call.respond(answer)?)
            }
            Err(error) => bail!(
                "the other side answered: {}",
                String::from_utf8_lossy(&error.payload().to_bytes())
            ),
        }
    }

    /// Waits for a route to the other side: Zenoh announces the server before it has a route, and replies to a query
    /// without a route at once with nothing.
    async fn reach(&self) -> Result<()> {
        let failed = |error| anyhow!("cannot watch the servers of {}: {error}", self.key);
        let listener = self.querier.matching_listener().await.map_err(failed)?;
        let status = self.querier.matching_status().await.map_err(failed)?;
        let mut is_matching = status.matching();
        while !is_matching {
            is_matching = listener.recv_async().await.map_err(failed)?.matching();
        }
        Ok(())
    }
}
