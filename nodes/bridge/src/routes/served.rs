//! A service of this side for callers on Zenoh.

use super::{Ends, OPEN_CALLS};
use crate::{announcement::Subject, plan::Route};
use anyhow::{Context as _, Result, anyhow};
use bytes::Bytes;
use std::sync::Arc;
use tokio::{runtime::Handle, sync::Semaphore};
use wm_ros::RawClient;
use zenoh::{
    key_expr::OwnedKeyExpr,
    liveliness::LivelinessToken,
    query::{Query, Queryable},
    sample::Locality,
};

/// The request of a query without payload: the CDR of an empty request, which has one byte in ROS.
const EMPTY_REQUEST: &[u8] = &[0, 1, 0, 0, 0];

pub(crate) struct LocalService {
    _queryable: Queryable<()>,
    _token: LivelinessToken,
}

impl LocalService {
    /// Answers queries of the service's key.
    ///
    /// # Errors
    /// Its name or type is invalid in ROS, or a side is closed.
    pub(crate) async fn begin(ends: Arc<Ends>, name: &str, route: &Route) -> Result<Self> {
        let key = ends.key_of(name)?;
        let server = Arc::new(Server {
            client: ends.node.raw_client(name, &route.type_name)?,
            key: key.clone(),
            ends: Arc::clone(&ends),
        });
        let (runtime, places) = (Handle::current(), Arc::new(Semaphore::new(OPEN_CALLS)));
        let queryable = ends
            .session
            .declare_queryable(key.clone())
            .allowed_origin(Locality::Remote)
            .callback(move |query| {
                let server = Arc::clone(&server);
                let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                    server.drop_call("too many are open");
                    return;
                };
                runtime.spawn(async move {
                    server.answer(query).await;
                    drop(place);
                });
            })
            .await
            .map_err(|error| anyhow!("cannot serve {key}: {error}"))?;
        let token = ends
            .announce(Subject::Server, &key, &route.type_name)
            .await?;
        Ok(Self {
            _queryable: queryable,
            _token: token,
        })
    }
}

struct Server {
    client: RawClient,
    key: OwnedKeyExpr,
    ends: Arc<Ends>,
}

impl Server {
    fn drop_call(&self, reason: &str) {
        let diagnostics = self.ends.node.diagnostics();
        diagnostics.count_drop(&format!("calls of {}: {reason}", self.client.name()));
    }

    async fn answer(&self, query: Query) {
        let replied = match self.call(&query).await {
            Ok(answer) => query.reply(self.key.clone(), answer).await,
            Err(error) => {
                tracing::warn!("{}: a call from Zenoh: {error:#}", self.client.name());
                self.drop_call("not answered");
                query.reply_err(format!("{error:#}")).await
            }
        };
        if let Err(error) = replied {
            tracing::debug!("{}: {error}", self.client.name());
            self.drop_call("the answer cannot be sent");
        }
    }

    async fn call(&self, query: &Query) -> Result<Bytes> {
        let request = match query.payload() {
            Some(payload) if !payload.is_empty() => Bytes::from(payload.to_bytes().into_owned()),
            _ => Bytes::from_static(EMPTY_REQUEST),
        };
        let timeout = self.ends.settings.queries_timeout;
        let call = async {
            // a request before the connection would be lost
            self.client.wait_for_service().await;
            self.client.call(request).await
        };
        let answer = tokio::time::timeout(timeout, call).await;
        Ok(answer.with_context(|| format!("no answer within {timeout:?}"))??)
    }
}
