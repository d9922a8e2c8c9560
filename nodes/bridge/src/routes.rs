//! The active routes.

mod called;
mod incoming;
mod outgoing;
mod served;

use crate::{
    announcement::{Announcement, Subject},
    plan::{Direction, Route, RouteId},
    settings::Settings,
};
use anyhow::{Context as _, Result, anyhow};
use called::RemoteService;
use incoming::IncomingTopic;
use outgoing::OutgoingTopic;
use served::LocalService;
use std::{collections::BTreeMap, sync::Arc, time::Duration};
use tokio::task::AbortHandle;
use wm_ros::Node;
use zenoh::{Session, key_expr::OwnedKeyExpr, liveliness::LivelinessToken};

/// The most open calls per service.
const OPEN_CALLS: usize = 64;

/// Time from the discovery of a remote endpoint until data reaches it. Zenoh's routers announce endpoints behind a new
/// neighbour at once, but compute routes 100 ms later (TREES_COMPUTATION_DELAY_MS). Samples and queries in between may
/// get lost.
const ROUTING: Duration = Duration::from_millis(300);

/// Both sides, and the bridge's settings.
pub(crate) struct Ends {
    /// The DDS side.
    pub node: Node,
    /// The Zenoh side.
    pub session: Session,
    pub settings: Settings,
}

impl Ends {
    /// The key on Zenoh of a name of this side.
    fn key_of(&self, name: &str) -> Result<OwnedKeyExpr> {
        let key = self.settings.namespace.key_of(name);
        key.with_context(|| format!("{name} has no key expression"))
    }

    /// Announces a topic or service to the other bridges while the token exists.
    async fn announce(
        &self,
        subject: Subject,
        key: &OwnedKeyExpr,
        type_name: &str,
    ) -> Result<LivelinessToken> {
        let failed = |error| anyhow!("cannot announce {key}: {error}");
        let announcement = Announcement {
            bridge: self.session.zid().to_string(),
            subject,
            key: key.to_string(),
            type_name: type_name.to_owned(),
        };
        let token = announcement.token().map_err(failed)?;
        let declared = self.session.liveliness().declare_token(token).await;
        declared.map_err(failed)
    }
}

/// A task that ends when this is dropped.
struct Task(AbortHandle);

impl Task {
    fn spawn(future: impl Future<Output = ()> + Send + 'static) -> Self {
        Self(tokio::spawn(future).abort_handle())
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// The endpoints of a route; dropping it ends the route.
enum Carrier {
    Outgoing(#[expect(dead_code, reason = "held while the route exists")] OutgoingTopic),
    Incoming(IncomingTopic),
    Served(#[expect(dead_code, reason = "held while the route exists")] LocalService),
    Called(RemoteService),
}

struct Running {
    route: Route,
    /// `None` if it could not start; retried when the route changes.
    carrier: Option<Carrier>,
}

pub(crate) struct Routes {
    ends: Arc<Ends>,
    running: BTreeMap<RouteId, Running>,
}

impl Routes {
    pub(crate) fn new(ends: Arc<Ends>) -> Self {
        Self {
            ends,
            running: BTreeMap::new(),
        }
    }

    /// Starts, ends and changes routes until they match `wanted`.
    pub(crate) async fn follow(&mut self, wanted: BTreeMap<RouteId, Route>) {
        self.running.retain(|id, running| {
            let stays = wanted
                .get(id)
                .is_some_and(|route| is_same_end(id.direction, &running.route, route));
            if !stays {
                tracing::info!("{:?} {}: ended", id.direction, id.name);
            }
            stays
        });
        for (id, route) in wanted {
            let carrier = match self.running.remove(&id) {
                Some(running) if running.route == route => running.carrier,
                Some(Running {
                    carrier: Some(mut carrier),
                    ..
                }) => self
                    .change(&mut carrier, &route)
                    .await
                    .map(|()| carrier)
                    .map_err(|error| warn_of(&id, &error))
                    .ok(),
                _ => self
                    .begin(&id, &route)
                    .await
                    .inspect(|_| tracing::info!("{:?} {}: begun", id.direction, id.name))
                    .map_err(|error| warn_of(&id, &error))
                    .ok(),
            };
            self.running.insert(id, Running { route, carrier });
        }
        let carried = self
            .running
            .values()
            .filter(|running| running.carrier.is_some());
        let diagnostics = self.ends.node.diagnostics();
        diagnostics.set_value("routes", carried.count());
    }

    async fn begin(&self, id: &RouteId, route: &Route) -> Result<Carrier> {
        let ends = Arc::clone(&self.ends);
        let name = id.name.as_str();
        Ok(match id.direction {
            Direction::Outgoing => {
                Carrier::Outgoing(OutgoingTopic::begin(ends, name, route).await?)
            }
            Direction::Incoming => {
                Carrier::Incoming(IncomingTopic::begin(ends, name, route).await?)
            }
            Direction::Served => Carrier::Served(LocalService::begin(ends, name, route).await?),
            Direction::Called => Carrier::Called(RemoteService::begin(ends, name, route).await?),
        })
    }

    async fn change(&self, carrier: &mut Carrier, route: &Route) -> Result<()> {
        match carrier {
            // these do not depend on the other end
            Carrier::Outgoing(_) | Carrier::Served(_) => Ok(()),
            Carrier::Incoming(incoming) => incoming.change(route).await,
            Carrier::Called(called) => called.change(route).await,
        }
    }
}

/// Whether a route can change without a restart.
fn is_same_end(direction: Direction, one: &Route, other: &Route) -> bool {
    match direction {
        Direction::Served | Direction::Called => one.type_name == other.type_name,
        Direction::Outgoing | Direction::Incoming => {
            one.type_name == other.type_name && one.qos == other.qos
        }
    }
}

fn warn_of(id: &RouteId, error: &anyhow::Error) {
    tracing::warn!("{:?} {} is not carried: {error:#}", id.direction, id.name);
}
