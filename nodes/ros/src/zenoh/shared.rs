//! What the endpoints of a session share, and their names on the wire.

use super::{
    calls::Calls,
    graph::{Graph, OwnEndpoint},
    key::data_key,
    session::OwnSession,
    token::{self, EndpointPart, Kind, NodePart},
};
use crate::{
    Durability, Error,
    backend::{Endpoint, EndpointId},
    local::Local,
    lock::lock,
    names::TypeName,
};
use std::{
    collections::BTreeMap,
    sync::{
        Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};
use tokio::runtime::Handle;
use wm_msgs::MessageType;
use zenoh::{Session, liveliness::LivelinessToken, query::Query};

/// What the endpoints of a session share.
pub(super) struct Shared {
    pub(super) session: OwnSession,
    pub(super) domain: u16,
    /// The session's id.
    pub(super) zid: String,
    /// The next number of a node or endpoint.
    next: AtomicU64,
    pub(super) nodes: Mutex<BTreeMap<String, (NodePart, LivelinessToken)>>,
    pub(super) runtime: Handle,
    pub(super) graph: Graph,
    pub(super) local: Local,
    pub(super) calls: Calls<Query>,
    pub(super) is_closed: AtomicBool,
}

/// An endpoint's names on the wire.
pub(super) struct Declared<'a> {
    pub(super) session: &'a Session,
    pub(super) id: EndpointId,
    pub(super) key: String,
    pub(super) token: String,
    /// Whether it is a subscription that also receives what ROS 2 Lyrical sends to host memory.
    pub(super) takes_buffers: bool,
}

impl Shared {
    pub(super) fn new(session: OwnSession, zid: String, domain: u16, runtime: Handle) -> Self {
        Self {
            domain,
            graph: Graph::new(zid.clone()),
            zid,
            session,
            next: AtomicU64::new(0),
            nodes: Mutex::default(),
            runtime,
            local: Local::default(),
            calls: Calls::default(),
            is_closed: AtomicBool::new(false),
        }
    }

    /// Whether the context has ended; endpoints then do nothing.
    pub(super) fn is_closed(&self) -> bool {
        self.is_closed.load(Ordering::Relaxed)
    }

    pub(super) fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }

    /// Names a new endpoint. A writer of answers and a reader of answers have no token of their own.
    pub(super) fn declare(
        &self,
        node: &str,
        endpoint: &Endpoint,
        is_writer: bool,
    ) -> Result<Declared<'_>, Error> {
        let session = self.session.get()?;
        let (name, type_name) = (&endpoint.name, &endpoint.type_name);
        let kind = Kind::of(endpoint.channel, is_writer);
        let info = endpoint.type_info.as_ref();
        let known = info.and_then(|info| info.hash.clone());
        let hash = known
            .clone()
            .or_else(|| self.graph.hash_of(endpoint))
            .or_else(|| hash_of_suite(type_name));
        // a subscription receives every hash, but a sample has one
        if hash.is_none() && kind != Kind::Subscription {
            return Err(Error::NoTypeHash {
                endpoint: name.clone(),
                type_name: type_name.to_string(),
            });
        }
        let takes_buffers = kind == Kind::Subscription
            && endpoint.qos.durability == Durability::Volatile
            && info.is_some_and(|info| info.has_byte_sequence);
        let part = EndpointPart {
            kind,
            name: name.clone(),
            type_name: type_name.clone(),
            hash: hash.clone(),
            qos: endpoint.qos,
        };
        let token = {
            let nodes = lock(&self.nodes);
            let (node, _) = nodes.get(node).ok_or_else(|| {
                Error::middleware(format!("make {name}"), format!("there is no node {node}"))
            })?;
            part.token(node, self.number(), takes_buffers)
        };
        let key_hash = known.or_else(|| hash.filter(|_| kind != Kind::Subscription));
        Ok(Declared {
            session,
            id: token::gid(&token),
            key: data_key(self.domain, name, type_name, key_hash.as_deref()),
            token,
            takes_buffers,
        })
    }

    pub(super) fn add_own(&self, id: EndpointId, own: OwnEndpoint) {
        if own.is_writer {
            self.local.add_writer(id, &own.endpoint);
        }
        self.graph.add_own(id, own);
    }
}

/// The hash that a subscription of any definition announces before a publisher is discovered, so that publishers of this
/// suite count it.
fn hash_of_suite(type_name: &TypeName) -> Option<String> {
    let known = MessageType::find(&type_name.to_string())?;
    // a test describes every definition of the suite
    Some(known.description().ok()?.hash().to_string())
}
