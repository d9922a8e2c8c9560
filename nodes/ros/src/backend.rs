//! The interface between this runtime and a middleware: bytes with a type name and a QoS, and the graph. Parameters,
//! services, logs and clocks use only this interface, which DDS and Zenoh implement.

use crate::{Error, Qos, names::TypeName, payload::Payload};
use futures::future::BoxFuture;
use std::time::Instant;
use tokio::sync::watch;

/// Identity of a reader or writer in the whole graph.
pub(crate) type EndpointId = [u8; 16];

/// Identity of a participant in the whole graph.
pub(crate) type ParticipantId = [u8; 12];

/// The kind of an endpoint, on which the middleware's spelling of its name depends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Channel {
    Topic,
    Request,
    Response,
}

/// An endpoint to be made.
#[derive(Clone, Debug)]
pub(crate) struct Endpoint {
    pub(crate) channel: Channel,
    /// Absolute: `/wm/latent`.
    pub(crate) name: String,
    pub(crate) type_name: TypeName,
    /// `None` for a type without a known definition.
    #[cfg_attr(
        not(feature = "zenoh"),
        allow(dead_code, reason = "rustdds cannot announce it")
    )]
    pub(crate) type_info: Option<TypeInfo>,
    pub(crate) qos: Qos,
    /// For a reader: whether it receives from this participant's own writers.
    pub(crate) receives_own: bool,
    /// For a reader: whether other readers of the same subscription receive from the publishers that its QoS excludes.
    pub(crate) has_siblings: bool,
}

/// What a middleware announces of a type besides its name.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(
    not(feature = "zenoh"),
    allow(dead_code, reason = "rustdds cannot announce it")
)]
pub(crate) struct TypeInfo {
    /// `RIHS01_...` (REP 2016). `None` for a reader that receives any definition of the type.
    pub(crate) hash: Option<String>,
    /// Whether the type or one that it contains has an unbounded sequence of bytes. ROS 2 Lyrical sends such messages in
    /// two ways.
    pub(crate) has_byte_sequence: bool,
}

/// The request that a sample is, or answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct RequestId {
    pub(crate) client: EndpointId,
    pub(crate) sequence: i64,
}

/// A received sample.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub(crate) payload: Payload,
    pub(crate) writer: EndpointId,
    pub(crate) sequence: i64,
    /// When the middleware received it, which is before the sink is called.
    pub(crate) arrived: Instant,
    /// The request that it belongs to.
    pub(crate) request: Option<RequestId>,
}

/// Receives samples; the error is the reason why a sample could not be read. Must not block: one thread serves all.
pub(crate) type Sink = Box<dyn FnMut(Result<Sample, String>) + Send>;

/// The outcome of writing a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WriteOutcome {
    /// Sent.
    Sent {
        /// Its sequence number.
        number: i64,
        /// Older samples that were dropped for readers that lag.
        dropped: u64,
    },
    /// An answer whose client is not connected yet: it is sent on connection, or dropped with a warning.
    Held,
    /// Not sent: too many samples are unacknowledged.
    WindowFull,
}

/// The policy of a reliable writer if its readers lag too far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WhenFull {
    /// Drops the oldest samples for the readers that lag.
    DropOldest,
    /// Does not send the new sample.
    Refuse,
}

/// The receivers of a sample published now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Audience {
    /// Readers of this context.
    pub(crate) here: bool,
    /// Readers of other participants, or late joiners that request older samples.
    pub(crate) elsewhere: bool,
}

/// Sends samples. Dropping it removes the endpoint from the graph.
pub(crate) trait Writer: Send + Sync {
    fn id(&self) -> EndpointId;
    fn audience(&self) -> Audience;
    /// Never blocks. The sample is encoded only if it leaves the process.
    fn write(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        when_full: WhenFull,
    ) -> Result<WriteOutcome, Error>;
    /// Waits until every matched reliable reader has acknowledged all samples.
    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>>;
}

/// Keeps a subscription alive. Dropping it removes the endpoint from the graph.
pub(crate) trait Reader: Send + Sync {
    fn id(&self) -> EndpointId;
}

/// An endpoint that discovery has found, in this process or another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DiscoveredEndpoint {
    pub(crate) channel: Channel,
    pub(crate) name: String,
    /// `package/msg/Type`, or `package/srv/Type` for a service.
    pub(crate) type_name: String,
    pub(crate) qos: Qos,
    pub(crate) is_writer: bool,
    pub(crate) id: EndpointId,
    pub(crate) participant: ParticipantId,
    /// Whether it belongs to this participant.
    pub(crate) is_own: bool,
    /// The hash of its type, if a publisher of another participant announces it.
    pub(crate) type_hash: Option<String>,
}

/// A middleware.
pub(crate) trait Backend: Send + Sync {
    /// This participant.
    fn participant(&self) -> ParticipantId;
    /// The participant of an endpoint; `None` for an undiscovered one.
    fn participant_of(&self, endpoint: &EndpointId) -> Option<ParticipantId>;
    /// Whether endpoints are not connected if one requests more than the other offers.
    fn excludes_by_qos(&self) -> bool;
    fn add_node(&self, namespace: &str, base: &str) -> Result<(), Error>;
    fn remove_node(&self, namespace: &str, base: &str);
    /// `node` is the full name of the endpoint's node.
    fn writer(&self, node: &str, endpoint: &Endpoint) -> Result<Box<dyn Writer>, Error>;
    fn reader(&self, node: &str, endpoint: &Endpoint, sink: Sink)
    -> Result<Box<dyn Reader>, Error>;
    /// The endpoints of topics and services.
    fn seen(&self) -> Vec<DiscoveredEndpoint>;
    /// The number of endpoints of other participants that this one is connected to.
    fn matched(&self, endpoint: &EndpointId) -> usize;
    /// Whether a server is connected to both ends of a client: to the writer `requests` and the reader `responses`.
    fn has_server(&self, requests: &EndpointId, responses: &EndpointId) -> bool {
        self.matched(requests) > 0 && self.matched(responses) > 0
    }
    /// The number of those that run another DDS implementation.
    fn foreign(&self, endpoint: &EndpointId) -> usize;
    /// Why endpoints of other participants on the same topic are not connected to this one, as text.
    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String>;
    /// Counts changes of the graph and of connections.
    fn changes(&self) -> watch::Receiver<u64>;
    /// The fault that stops it from receiving or sending; permanent.
    fn failure(&self) -> Option<Error>;
    /// Waits briefly until the samples of dropped writers are delivered. Call it while the runtime still runs.
    fn settle(&self);
    /// Leaves the graph. Remaining readers and writers do nothing from then on.
    fn close(&self);
}
