//! Liveliness tokens: a key for each node and endpoint, which exists as long as it. Together they are the graph.
//!
//! `@ros2_lv/<domain>/<session>/<node's number>/<number>/<kind>/<enclave>/<namespace>/<node>`, and for an endpoint
//! `/<name>/<type>/<hash>/<qos>` (`liveliness_utils.cpp` of rmw_zenoh). ROS 2 Lyrical appends
//! `/backends:<names>:` to endpoints whose type has sequences of bytes.

use super::{
    key::{demangled, mangled, ros_type, wire_type},
    qos_text,
};
use crate::{
    Qos,
    backend::{Channel, EndpointId},
    names::TypeName,
};

const SPACE: &str = "@ros2_lv";
/// The enclave `/`. Others are for SROS 2.
const ENCLAVE: &str = "%";
/// The hash of ROS 2 Humble, which has none.
const NO_HASH: &str = "TypeHashNotSupported";
/// Of a subscription that receives messages with sequences of bytes in host memory.
const HOST_MEMORY: &str = "/backends:cpu:";

/// The kind of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Publisher,
    Subscription,
    Server,
    Client,
}

impl Kind {
    const ALL: [Self; 4] = [
        Self::Publisher,
        Self::Subscription,
        Self::Server,
        Self::Client,
    ];

    /// The kind of the sending (`is_writer`) or receiving end of a channel.
    pub(super) fn of(channel: Channel, is_writer: bool) -> Self {
        match (channel, is_writer) {
            (Channel::Topic, true) => Self::Publisher,
            (Channel::Topic, false) => Self::Subscription,
            (Channel::Request, false) | (Channel::Response, true) => Self::Server,
            (Channel::Request, true) | (Channel::Response, false) => Self::Client,
        }
    }

    fn text(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscription => "MS",
            Self::Server => "SS",
            Self::Client => "SC",
        }
    }

    /// The kind that it exchanges messages with.
    pub(super) fn opposite(self) -> Self {
        match self {
            Self::Publisher => Self::Subscription,
            Self::Subscription => Self::Publisher,
            Self::Server => Self::Client,
            Self::Client => Self::Server,
        }
    }
}

/// Tokens of every node and endpoint of a domain.
pub(super) fn all(domain: u16) -> String {
    format!("{SPACE}/{domain}/**")
}

/// A node in a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct NodePart {
    pub(super) domain: u16,
    /// The Zenoh session's id.
    pub(super) session: String,
    pub(super) number: u64,
    /// `/wm`; `/` for none.
    pub(super) namespace: String,
    pub(super) name: String,
}

impl NodePart {
    pub(super) fn token(&self) -> String {
        self.part(self.number, "NN")
    }

    fn part(&self, number: u64, kind: &str) -> String {
        let Self {
            domain,
            session,
            number: node,
            namespace,
            name,
        } = self;
        let (namespace, name) = (mangled(namespace), mangled(name));
        format!("{SPACE}/{domain}/{session}/{node}/{number}/{kind}/{ENCLAVE}/{namespace}/{name}")
    }
}

/// An endpoint in a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct EndpointPart {
    pub(super) kind: Kind,
    /// Absolute.
    pub(super) name: String,
    pub(super) type_name: TypeName,
    /// `None` if it is not announced.
    pub(super) hash: Option<String>,
    pub(super) qos: Qos,
}

impl EndpointPart {
    /// `takes_buffers`: a subscription that also subscribes to [`byte_sequence_key`](super::key::byte_sequence_key).
    pub(super) fn token(&self, node: &NodePart, number: u64, takes_buffers: bool) -> String {
        let Self {
            kind,
            name,
            type_name,
            hash,
            qos,
        } = self;
        let node = node.part(number, kind.text());
        let (name, type_name) = (mangled(name), wire_type(type_name));
        let (hash, qos) = (hash.as_deref().unwrap_or(NO_HASH), qos_text::text(*qos));
        let backends = if takes_buffers { HOST_MEMORY } else { "" };
        format!("{node}/{name}/{type_name}/{hash}/{qos}{backends}")
    }
}

/// The session and the endpoint of a token; `None` for a node's token, for types outside ROS, and for malformed ones.
pub(super) fn parse(token: &str) -> Option<(String, EndpointPart)> {
    let chunks: Vec<&str> = token.split('/').collect();
    let [
        space,
        _domain,
        session,
        _node,
        _number,
        kind,
        _enclave,
        _namespace,
        _name,
        topic,
        wire_type,
        hash,
        qos,
        ..,
    ] = chunks[..]
    else {
        return None;
    };
    let kind = Kind::ALL.into_iter().find(|known| known.text() == kind)?;
    let name = demangled(topic);
    let is_valid = space == SPACE && name.len() > 1 && name.starts_with('/');
    let endpoint = EndpointPart {
        kind,
        name,
        type_name: ros_type(&demangled(wire_type))?,
        hash: hash.starts_with("RIHS").then(|| hash.to_owned()),
        qos: qos_text::parse(qos)?,
    };
    is_valid.then(|| (session.to_owned(), endpoint))
}

/// The GUID of a node or endpoint: the XXH3 hash of its token, 128 bits, little endian.
pub(super) fn gid(token: &str) -> EndpointId {
    twox_hash::XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn node() -> NodePart {
        NodePart {
            domain: 2,
            session: "aac3178e146ba6f1fc6e6a4085e77f21".into(),
            number: 0,
            namespace: "/".into(),
            name: "listener".into(),
        }
    }

    fn endpoint() -> EndpointPart {
        EndpointPart {
            kind: Kind::Subscription,
            name: "/chatter".into(),
            type_name: TypeName::message("std_msgs", "String"),
            hash: Some(
                "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18".into(),
            ),
            qos: Qos::reliable(10),
        }
    }

    /// As in rmw_zenoh's `docs/design.md`.
    #[test]
    fn tokens_are_those_of_rmw_zenoh() {
        assert_eq!(
            node().token(),
            "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
        );
        assert_eq!(
            endpoint().token(&node(), 10, false),
            "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,10:,:,:,,"
        );
        assert!(
            endpoint()
                .token(&node(), 10, true)
                .ends_with(":,,/backends:cpu:")
        );
    }

    #[test]
    fn gid_is_the_hash_of_the_token() {
        // of the empty text, by xxHash itself
        let empty = u128::from_le_bytes(gid(""));
        assert_eq!(empty, 0x99aa_06d3_0147_98d8_6001_c324_468d_497f);
    }

    #[test]
    fn foreign_tokens_are_parsed() {
        let lyrical = endpoint().token(&node(), 3, true);
        assert_eq!(parse(&lyrical).map(|(_, parsed)| parsed), Some(endpoint()));
        let humble = EndpointPart {
            hash: None,
            ..endpoint()
        };
        let token = humble.token(&node(), 3, false);
        assert!(token.contains("/TypeHashNotSupported/"));
        assert_eq!(parse(&token), Some((node().session, humble)));
        assert_eq!(parse(&node().token()), None);
        assert_eq!(
            parse("@ros2_lv/0/a/0/1/MP/%/%/n/%t/bool/h/::,1:,:,:,,"),
            None
        );
    }

    proptest! {
        #[test]
        fn endpoints_survive(kind in 0_usize..4, name in "(/[a-z_]{1,9}){1,3}", depth in 1_usize..99) {
            let part = EndpointPart { kind: Kind::ALL[kind], name, qos: Qos::best_effort(depth), ..endpoint() };
            let (session, parsed) = parse(&part.token(&node(), 7, false)).unwrap();
            prop_assert_eq!(session, node().session);
            prop_assert_eq!(parsed, part);
        }

        #[test]
        fn arbitrary_tokens_do_not_panic(token in ".{0,120}") {
            parse(&token);
        }
    }
}
