//! The endpoints of the other sessions, from their liveliness tokens.

use super::token::{self, EndpointPart, Kind};
use crate::{
    backend::{Channel, DiscoveredEndpoint, Endpoint, EndpointId, ParticipantId},
    lock::lock,
};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
};
use tokio::sync::watch;

/// Remembered endpoints of other sessions: hundreds of nodes. Others are not discovered, with a warning.
const MOST_ENDPOINTS: usize = 65_536;

/// Explanations per endpoint; see [`Graph::mismatches`].
const MOST_MISMATCHES: usize = 64;

/// An endpoint of this process.
#[derive(Clone)]
pub(super) struct OwnEndpoint {
    pub(super) endpoint: Endpoint,
    pub(super) is_writer: bool,
    /// Whether Zenoh has a route from it to others; what only receives needs none.
    pub(super) is_routed: Arc<AtomicBool>,
}

impl OwnEndpoint {
    pub(super) fn new(endpoint: &Endpoint, is_writer: bool) -> Self {
        Self {
            endpoint: endpoint.clone(),
            is_writer,
            is_routed: Arc::new(AtomicBool::new(true)),
        }
    }

    fn kind(&self) -> Kind {
        Kind::of(self.endpoint.channel, self.is_writer)
    }

    /// Whether the two exchange messages, except that their types may differ.
    fn faces(&self, other: &EndpointPart) -> bool {
        other.kind == self.kind().opposite() && other.name == self.endpoint.name
    }

    fn hash(&self) -> Option<&str> {
        let info = self.endpoint.type_info.as_ref();
        info?.hash.as_deref()
    }

    fn is_connected_to(&self, other: &EndpointPart) -> bool {
        // without a hash of its own, an endpoint is connected to every hash
        let is_same_hash = self
            .hash()
            .is_none_or(|hash| other.hash.as_deref() == Some(hash));
        self.faces(other) && other.type_name == self.endpoint.type_name && is_same_hash
    }

    /// Why the two are not connected, although their names are the same.
    fn mismatch(&self, other: &EndpointPart) -> Option<String> {
        if !self.faces(other) || self.is_connected_to(other) {
            return None;
        }
        let (name, own) = (&self.endpoint.name, &self.endpoint.type_name);
        let what = match other.kind {
            Kind::Publisher => "a publisher",
            Kind::Subscription => "a subscription",
            Kind::Server => "a server",
            Kind::Client => "a client",
        };
        let theirs = &other.type_name;
        Some(if theirs == own {
            let hash = other.hash.as_deref().unwrap_or("none");
            format!(
                "{name}: {what} has another definition of {own} (hash {hash}, here {}): they cannot communicate",
                self.hash().unwrap_or("unknown")
            )
        } else {
            format!(
                "{name}: {what} has the type {theirs}, but this node uses {own}: they cannot communicate"
            )
        })
    }

    fn discovered(&self, id: EndpointId, participant: ParticipantId) -> DiscoveredEndpoint {
        let endpoint = &self.endpoint;
        DiscoveredEndpoint {
            channel: endpoint.channel,
            name: endpoint.name.clone(),
            type_name: endpoint.type_name.to_string(),
            qos: endpoint.qos,
            is_writer: self.is_writer,
            id,
            participant,
            is_own: true,
            type_hash: None,
        }
    }
}

struct OtherEndpoint {
    participant: ParticipantId,
    part: EndpointPart,
}

/// The identity of a session in the graph.
pub(super) fn participant(session: &str) -> ParticipantId {
    let hash = token::gid(session);
    std::array::from_fn(|index| hash[index])
}

/// This session's own and other endpoints.
pub(super) struct Graph {
    session: String,
    own: Mutex<BTreeMap<EndpointId, OwnEndpoint>>,
    others: Mutex<BTreeMap<EndpointId, OtherEndpoint>>,
    is_full: AtomicBool,
    changes: watch::Sender<u64>,
}

impl Graph {
    /// `session`: this session's Zenoh id.
    pub(super) fn new(session: String) -> Self {
        Self {
            session,
            own: Mutex::default(),
            others: Mutex::default(),
            is_full: AtomicBool::new(false),
            changes: watch::Sender::new(0),
        }
    }

    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    pub(super) fn changed(&self) {
        self.changes.send_modify(|count| *count += 1);
    }

    /// A token has appeared.
    pub(super) fn add(&self, token: &str) {
        let Some((session, part)) = token::parse(token) else {
            return;
        };
        if session == self.session {
            return;
        }
        let mismatches: Vec<_> = {
            let own = lock(&self.own);
            own.values().filter_map(|own| own.mismatch(&part)).collect()
        };
        let other = OtherEndpoint {
            participant: participant(&session),
            part,
        };
        {
            let mut others = lock(&self.others);
            if others.len() >= MOST_ENDPOINTS {
                if !self.is_full.swap(true, Ordering::Relaxed) {
                    tracing::warn!(
                        "the graph has more than {MOST_ENDPOINTS} endpoints: others are not discovered"
                    );
                }
                return;
            }
            others.insert(token::gid(token), other);
        }
        mismatches.iter().for_each(|text| tracing::warn!("{text}"));
        self.changed();
    }

    /// A token has disappeared. Returns its endpoint, if it was known.
    pub(super) fn remove(&self, token: &str) -> Option<EndpointId> {
        let id = token::gid(token);
        lock(&self.others).remove(&id)?;
        self.changed();
        Some(id)
    }

    pub(super) fn add_own(&self, id: EndpointId, own: OwnEndpoint) {
        let mismatches: Vec<_> = {
            let others = lock(&self.others);
            let parts = others.values().map(|other| &other.part);
            parts.filter_map(|part| own.mismatch(part)).collect()
        };
        lock(&self.own).insert(id, own);
        mismatches.iter().for_each(|text| tracing::warn!("{text}"));
        self.changed();
    }

    pub(super) fn remove_own(&self, id: &EndpointId) {
        lock(&self.own).remove(id);
        self.changed();
    }

    pub(super) fn is_own(&self, id: &EndpointId) -> bool {
        lock(&self.own).contains_key(id)
    }

    /// The endpoints of other sessions that this one is connected to.
    pub(super) fn matched(&self, id: &EndpointId) -> usize {
        let Some(own) = lock(&self.own).get(id).cloned() else {
            return 0;
        };
        // Without a route, calls and samples are lost.
        if !own.is_routed.load(Ordering::Relaxed) {
            return 0;
        }
        let others = lock(&self.others);
        let connected = others
            .values()
            .filter(|other| own.is_connected_to(&other.part));
        connected.count()
    }

    /// Why endpoints of the same name are not connected to this one.
    pub(super) fn mismatches(&self, id: &EndpointId) -> Vec<String> {
        let Some(own) = lock(&self.own).get(id).cloned() else {
            return Vec::new();
        };
        let others = lock(&self.others);
        let texts = others
            .values()
            .filter_map(|other| own.mismatch(&other.part));
        let mut texts: Vec<_> = texts.take(MOST_MISMATCHES).collect();
        texts.dedup();
        texts
    }

    /// The hash of a type, as another endpoint of the topic or service announces it.
    pub(super) fn hash_of(&self, endpoint: &Endpoint) -> Option<String> {
        let others = lock(&self.others);
        let mut parts = others.values().map(|other| &other.part);
        let is_its = |part: &&EndpointPart| {
            part.name == endpoint.name && part.type_name == endpoint.type_name
        };
        parts.find(is_its)?.hash.clone()
    }

    /// The session of an endpoint.
    pub(super) fn participant_of(&self, id: &EndpointId) -> Option<ParticipantId> {
        if self.is_own(id) {
            return Some(participant(&self.session));
        }
        lock(&self.others).get(id).map(|other| other.participant)
    }

    pub(super) fn seen(&self) -> Vec<DiscoveredEndpoint> {
        let session = participant(&self.session);
        let mut seen: Vec<_> = {
            let own = lock(&self.own);
            own.iter()
                .map(|(id, own)| own.discovered(*id, session))
                .collect()
        };
        let others = lock(&self.others);
        seen.extend(others.iter().map(|(id, other)| {
            let part = &other.part;
            let (channel, is_writer) = match part.kind {
                Kind::Publisher => (Channel::Topic, true),
                Kind::Subscription => (Channel::Topic, false),
                Kind::Server => (Channel::Request, false),
                Kind::Client => (Channel::Request, true),
            };
            DiscoveredEndpoint {
                channel,
                name: part.name.clone(),
                type_name: part.type_name.to_string(),
                qos: part.qos,
                is_writer,
                id: *id,
                participant: other.participant,
                is_own: false,
                type_hash: part.hash.clone().filter(|_| is_writer),
            }
        }));
        seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Qos, backend::TypeInfo, names::TypeName, zenoh::token::NodePart};

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    fn token(kind: Kind, name: &str, type_name: TypeName, hash: &str) -> String {
        let node = NodePart {
            domain: 0,
            session: "abc".into(),
            number: 0,
            namespace: "/".into(),
            name: "other".into(),
        };
        let part = EndpointPart {
            kind,
            name: name.into(),
            type_name,
            hash: Some(hash.into()),
            qos: Qos::reliable(10),
        };
        part.token(&node, 1, false)
    }

    fn string() -> TypeName {
        TypeName::message("std_msgs", "String")
    }

    fn with_subscription() -> (Graph, EndpointId) {
        let graph = Graph::new("own".into());
        let endpoint = Endpoint {
            channel: Channel::Topic,
            name: "/chatter".into(),
            type_name: string(),
            type_info: Some(TypeInfo {
                hash: Some(HASH.into()),
                has_byte_sequence: false,
            }),
            qos: Qos::reliable(1),
            receives_own: true,
            has_siblings: false,
        };
        graph.add_own([1; 16], OwnEndpoint::new(&endpoint, false));
        (graph, [1; 16])
    }

    #[test]
    fn endpoints_of_the_same_name_type_and_hash_are_connected() {
        let (graph, own) = with_subscription();
        let mut changes = graph.changes();
        changes.mark_unchanged();
        let publisher = token(Kind::Publisher, "/chatter", string(), HASH);
        graph.add(&publisher);
        assert!(changes.has_changed().unwrap());
        graph.add(&token(Kind::Publisher, "/other", string(), HASH));
        graph.add(&token(Kind::Subscription, "/chatter", string(), HASH));
        assert_eq!(graph.matched(&own), 1);
        assert_eq!(
            graph.participant_of(&token::gid(&publisher)),
            Some(participant("abc"))
        );
        assert_eq!(graph.remove(&publisher), Some(token::gid(&publisher)));
        assert_eq!((graph.matched(&own), graph.remove(&publisher)), (0, None));
    }

    #[test]
    fn mismatch_names_the_types_or_the_hashes() {
        let (graph, own) = with_subscription();
        graph.add(&token(
            Kind::Publisher,
            "/chatter",
            TypeName::message("std_msgs", "Bool"),
            HASH,
        ));
        graph.add(&token(Kind::Publisher, "/chatter", string(), "RIHS01_00"));
        let texts = graph.mismatches(&own).join("\n");
        assert!(
            texts.contains("/chatter: a publisher has the type std_msgs/msg/Bool, but"),
            "{texts}"
        );
        assert!(
            texts.contains("another definition of std_msgs/msg/String (hash RIHS01_00, here"),
            "{texts}"
        );
        assert_eq!(graph.matched(&own), 0);
    }

    #[test]
    fn tokens_of_the_own_session_are_ignored() {
        let graph = Graph::new("abc".into());
        graph.add(&token(Kind::Publisher, "/chatter", string(), HASH));
        assert!(graph.seen().is_empty());
    }
}
