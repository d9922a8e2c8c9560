//! A service on Zenoh to this side's clients.

use super::{Ends, OPEN_CALLS, Task};
use crate::{announcement::Subject, plan::Route, request_header::RequestHeader};
use anyhow::{Context as _, Result, anyhow, bail};
use bytes::Bytes;
use std::sync::Arc;
use tokio::sync::Semaphore;
use wm_ros::{RawCall, RawService};
use zenoh::{key_expr::OwnedKeyExpr, liveliness::LivelinessToken, sample::Locality};

/// A service that is called on Zenoh. It is served on this side while another bridge announces it: a client that finds
/// a server which nobody answers for would wait for ever.
pub struct Called {
    ends: Arc<Ends>,
    name: String,
    key: OwnedKeyExpr,
    type_name: String,
    serving: Option<Task>,
    token: Option<LivelinessToken>,
}

impl Called {
    /// Serves the service on this side, where it is there.
    ///
    /// # Errors
    /// Its name or type is none of ROS, or one of the sides is closed.
    pub async fn begin(ends: Arc<Ends>, name: &str, route: &Route) -> Result<Self> {
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

    /// Begins or ends to serve it, and to announce this side's clients.
    ///
    /// # Errors
    /// Its name or type is none of ROS, or one of the sides is closed.
    pub async fn change(&mut self, route: &Route) -> Result<()> {
        self.serving = match (self.serving.take(), route.is_remote) {
            (_, false) => None,
            (Some(serving), true) => Some(serving),
            (None, true) => {
                let node = &self.ends.node;
                let service = node.raw_service_for_others(&self.name, &self.type_name)?;
                let (ends, key) = (Arc::clone(&self.ends), self.key.clone());
                Some(Task::spawn(serve(ends, service, key)))
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

async fn serve(ends: Arc<Ends>, mut service: RawService, key: OwnedKeyExpr) {
    let places = Arc::new(Semaphore::new(OPEN_CALLS));
    while let Some(call) = service.recv().await {
        // The service's own queue is bounded, and drops the oldest call.
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        let (ends, key) = (Arc::clone(&ends), key.clone());
        tokio::spawn(async move {
            if let Err(error) = carry(&ends, call, &key).await {
                // ROS has no way to tell the client; it waits until it gives up.
                tracing::warn!("a call of {key} is not answered: {error:#}");
                let diagnostics = ends.node.diagnostics();
                diagnostics.count_drop(&format!("calls of zenoh {key}: not answered"));
            }
            drop(place);
        });
    }
}

async fn carry(ends: &Ends, mut call: RawCall, key: &OwnedKeyExpr) -> Result<()> {
    let timeout = ends.settings.queries_timeout;
    let header = RequestHeader::of_call(call.id());
    let replies = ends
        .session
        .get(key.clone())
        .payload(std::mem::take(&mut call.request))
        .attachment(header.to_bytes().to_vec())
        .allowed_destination(Locality::Remote)
        .timeout(timeout)
        .await
        .map_err(|error| anyhow!("{error}"))?;
    let reply = replies.recv_async().await;
    let reply = reply
        .ok()
        .with_context(|| format!("nothing came within {timeout:?}"))?;
    match reply.result() {
        Ok(sample) => {
            let answer = Bytes::from(sample.payload().to_bytes().into_owned());
            Ok(call.respond(answer)?)
        }
        Err(error) => bail!(
            "the other side says: {}",
            String::from_utf8_lossy(&error.payload().to_bytes())
        ),
    }
}
