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
use called::Called;
use incoming::Incoming;
use outgoing::Outgoing;
use served::Served;
use std::{collections::BTreeMap, sync::Arc, time::Duration};
use tokio::task::AbortHandle;
use wm_ros::Node;
use zenoh::{Session, key_expr::OwnedKeyExpr, liveliness::LivelinessToken};

/// Calls of one service that may be under way at once.
const OPEN_CALLS: usize = 64;

/// From when a way to the other side is known until it holds. Zenoh's routers tell each other at once of what is beyond a new
/// neighbour, and compute their routes 100 ms later (TREES_COMPUTATION_DELAY_MS): what is sent meanwhile may end at the
/// neighbour, samples and queries alike.
const ROUTING: Duration = Duration::from_millis(300);

/// Both sides, and what is carried between them.
pub struct Ends {
    /// On the DDS side.
    pub node: Node,
    /// On the Zenoh side.
    pub session: Session,
    /// What is carried, and how.
    pub settings: Settings,
}

impl Ends {
    /// The key on Zenoh of a name of this side.
    fn key_of(&self, name: &str) -> Result<OwnedKeyExpr> {
        let key = self.settings.namespace.key_of(name);
        key.with_context(|| format!("{name} has no key expression"))
    }

    /// Tells the other bridges of a topic or service for as long as the token is held.
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

/// What carries a route; dropping it ends it.
enum Carrier {
    Outgoing(#[expect(dead_code, reason = "held for as long as it carries")] Outgoing),
    Incoming(Incoming),
    Served(#[expect(dead_code, reason = "held for as long as it carries")] Served),
    Called(Called),
}

struct Running {
    route: Route,
    /// `None` where it could not be begun; it is tried again when the route is another.
    carrier: Option<Carrier>,
}

/// All routes.
pub struct Routes {
    ends: Arc<Ends>,
    running: BTreeMap<RouteId, Running>,
}

impl Routes {
    /// None yet.
    pub fn new(ends: Arc<Ends>) -> Self {
        Self {
            ends,
            running: BTreeMap::new(),
        }
    }

    /// Ends, begins and changes routes until they are those that are wanted.
    pub async fn follow(&mut self, wanted: BTreeMap<RouteId, Route>) {
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
            Direction::Outgoing => Carrier::Outgoing(Outgoing::begin(ends, name, route).await?),
            Direction::Incoming => Carrier::Incoming(Incoming::begin(ends, name, route).await?),
            Direction::Served => Carrier::Served(Served::begin(ends, name, route).await?),
            Direction::Called => Carrier::Called(Called::begin(ends, name, route).await?),
        })
    }

    async fn change(&self, carrier: &mut Carrier, route: &Route) -> Result<()> {
        match carrier {
            // Whether another bridge has the other end makes no difference to these.
            Carrier::Outgoing(_) | Carrier::Served(_) => Ok(()),
            Carrier::Incoming(incoming) => incoming.change(route).await,
            Carrier::Called(called) => called.change(route).await,
        }
    }
}

/// Whether a route can become another without being begun anew.
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
