//! The session of a process, and its nodes.

use super::{
    graph::participant,
    reader::ZenohReader,
    session::{OwnSession, alone, router_check_attempts, session_config},
    shared::Shared,
    token::{self, NodePart},
    writer::{RequestWriter, ResponseWriter, TopicWriter},
};
use crate::{
    Environment, Error,
    backend::{
        Backend, Channel, DiscoveredEndpoint, Endpoint, EndpointId, ParticipantId, Reader, Sink,
        Writer,
    },
    lock::lock,
};
use std::{
    sync::{Arc, Mutex, Weak, atomic::Ordering},
    thread,
    time::Duration,
};
use tokio::{runtime::Handle, sync::watch};
use zenoh::{Wait as _, pubsub::Subscriber, sample::SampleKind};

/// Between two looks for a router, as in rmw_zenoh.
const ROUTER_CHECK_PERIOD: Duration = Duration::from_secs(1);

/// A Zenoh session in a domain.
pub(crate) struct Zenoh {
    shared: Arc<Shared>,
    /// Of the liveliness tokens.
    subscriber: Mutex<Option<Subscriber<()>>>,
}

fn full_name(namespace: &str, base: &str) -> String {
    format!("{}/{base}", namespace.trim_end_matches('/'))
}

impl Zenoh {
    /// Opens a session. `runtime` runs the receiving tasks; stop it before [`Backend::close`].
    pub(crate) fn join(environment: &Environment, runtime: Handle) -> Result<Arc<Self>, Error> {
        let config = match environment.is_alone() {
            true => alone()?,
            false => session_config()?,
        };
        let attempts = router_check_attempts()?.filter(|_| !environment.is_alone());
        let session = OwnSession::open(config)?;
        let zid = session.get()?.zid().to_string();
        let shared = Arc::new(Shared::new(session, zid, environment.domain_id, runtime));
        let known = Arc::downgrade(&shared);
        let tokens = shared.session.get()?.liveliness();
        let tokens = tokens.declare_subscriber(token::all(environment.domain_id));
        let subscriber = tokens.history(true).callback(move |sample| {
            let Some(shared) = known.upgrade() else {
                return;
            };
            let token = sample.key_expr().as_str();
            match sample.kind() {
                SampleKind::Put => shared.graph.add(token),
                SampleKind::Delete => {
                    if let Some(gone) = shared.graph.remove(token) {
                        shared.calls.forget(&gone);
                    }
                }
            }
        });
        let subscriber = subscriber
            .wait()
            .map_err(|error| Error::middleware("discover the graph", error))?;
        if let Some(attempts) = attempts {
            look_for_router(Arc::downgrade(&shared), attempts)?;
        }
        Ok(Arc::new(Self {
            shared,
            subscriber: Mutex::new(Some(subscriber)),
        }))
    }
}

/// Warns if no router is connected after so many looks.
fn look_for_router(shared: Weak<Shared>, attempts: u64) -> Result<(), Error> {
    let look = move || {
        let mut looks = 0;
        loop {
            {
                let Some(shared) = shared.upgrade() else {
                    return;
                };
                let Ok(session) = shared.session.get() else {
                    return;
                };
                if session.info().routers_zid().wait().next().is_some() {
                    return;
                }
            }
            looks += 1;
            if looks == attempts || (attempts == u64::MAX && looks == 1) {
                tracing::warn!(
                    "no Zenoh router is connected, so other nodes are not discovered: start one with `wm zenoh-router`, or \
                     `ros2 run rmw_zenoh_cpp rmw_zenohd`"
                );
            }
            if looks >= attempts {
                return;
            }
            thread::sleep(ROUTER_CHECK_PERIOD);
        }
    };
    let thread = thread::Builder::new().name("zenoh_router".to_owned());
    let started = thread.spawn(look);
    started
        .map(drop)
        .map_err(|source| Error::io("start a thread", source))
}

impl Backend for Zenoh {
    fn participant(&self) -> ParticipantId {
        participant(&self.shared.zid)
    }

    fn participant_of(&self, endpoint: &EndpointId) -> Option<ParticipantId> {
        self.shared.graph.participant_of(endpoint)
    }

    fn excludes_by_qos(&self) -> bool {
        false
    }

    fn add_node(&self, namespace: &str, base: &str) -> Result<(), Error> {
        let shared = &self.shared;
        let node = NodePart {
            domain: shared.domain,
            session: shared.zid.clone(),
            number: shared.number(),
            namespace: namespace.to_owned(),
            name: base.to_owned(),
        };
        let token = shared.session.get()?.liveliness();
        let token = token.declare_token(node.token()).wait();
        let name = full_name(namespace, base);
        let token = token.map_err(|error| Error::middleware(format!("announce {name}"), error))?;
        lock(&shared.nodes).insert(name, (node, token));
        Ok(())
    }

    fn remove_node(&self, namespace: &str, base: &str) {
        let removed = lock(&self.shared.nodes).remove(&full_name(namespace, base));
        drop(removed);
    }

    fn writer(&self, node: &str, endpoint: &Endpoint) -> Result<Box<dyn Writer>, Error> {
        let shared = &self.shared;
        Ok(match endpoint.channel {
            Channel::Topic => Box::new(TopicWriter::new(shared, node, endpoint)?),
            Channel::Request => Box::new(RequestWriter::new(shared, node, endpoint)?),
            Channel::Response => Box::new(ResponseWriter::new(shared, node, endpoint)?),
        })
    }

    fn reader(
        &self,
        node: &str,
        endpoint: &Endpoint,
        sink: Sink,
    ) -> Result<Box<dyn Reader>, Error> {
        let reader = ZenohReader::new(&self.shared, node, endpoint, sink)?;
        Ok(Box::new(reader))
    }

    fn seen(&self) -> Vec<DiscoveredEndpoint> {
        self.shared.graph.seen()
    }

    fn matched(&self, endpoint: &EndpointId) -> usize {
        self.shared.graph.matched(endpoint) + self.shared.local.matched(endpoint)
    }

    fn foreign(&self, _: &EndpointId) -> usize {
        0
    }

    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String> {
        self.shared.graph.mismatches(endpoint)
    }

    fn changes(&self) -> watch::Receiver<u64> {
        self.shared.graph.changes()
    }

    fn failure(&self) -> Option<Error> {
        let is_lost = !self.shared.is_closed() && self.shared.session.get().is_err();
        is_lost.then_some(Error::SessionEnded)
    }

    fn settle(&self) {}

    fn close(&self) {
        self.shared.is_closed.store(true, Ordering::Relaxed);
        drop(lock(&self.subscriber).take());
        let nodes = std::mem::take(&mut *lock(&self.shared.nodes));
        drop(nodes);
        self.shared.session.close();
    }
}
