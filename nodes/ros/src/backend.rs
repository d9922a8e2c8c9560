//! The seam between this runtime and a middleware: bytes with a type name and a QoS out and in, and the graph.
//! Everything above it (parameters, services, logs, clocks) is written once, in these terms; a second middleware
//! implements these traits and nothing else.

use crate::{Error, Qos, names::TypeName, payload::Payload};
use futures::future::BoxFuture;
use tokio::sync::watch;

/// Identity of a reader or writer in the whole graph.
pub(crate) type EndpointId = [u8; 16];

/// The first twelve bytes of an endpoint's GUID name its participant.
pub(crate) fn participant_of(id: &EndpointId) -> [u8; 12] {
    std::array::from_fn(|index| id[index])
}

/// What an endpoint carries, which decides how the middleware spells its name.
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
    pub(crate) qos: Qos,
    /// For a reader: whether it hears this participant's own writers.
    pub(crate) hears_own: bool,
    /// For a reader: whether siblings in the same subscription receive from the publishers that its reliability or
    /// durability excludes.
    pub(crate) has_siblings: bool,
}

/// Which request a sample is, or answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct RequestId {
    pub(crate) client: EndpointId,
    pub(crate) sequence: i64,
}

/// A sample that came in.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub(crate) payload: Payload,
    pub(crate) writer: EndpointId,
    pub(crate) sequence: i64,
    /// The request that it belongs to.
    pub(crate) request: Option<RequestId>,
}

/// Takes what comes in; the error says why a sample could not be read. Must not block: one thread serves all.
pub(crate) type Sink = Box<dyn FnMut(Result<Sample, String>) + Send>;

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Written {
    /// It is on its way.
    Sent {
        /// Its place in the writer's numbering.
        number: i64,
        /// Older samples that were dropped for readers that have fallen behind.
        dropped: u64,
    },
    /// An answer whose client is not connected yet: it is sent as soon as it is, or dropped with a warning.
    Held,
    /// The readers have not acknowledged enough: it was not taken.
    WindowFull,
}

/// What happens to a sample of a reliable writer when its readers have fallen too far behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WhenFull {
    /// The oldest samples are dropped for the readers that have not taken them.
    DropOldest,
    /// The new sample is not taken.
    Refuse,
}

/// Who would get a sample now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Audience {
    /// Readers of this context.
    pub(crate) here: bool,
    /// Readers elsewhere, or any that may join and ask for what was sent before.
    pub(crate) elsewhere: bool,
}

/// Sends samples. Dropping it takes the endpoint out of the graph.
pub(crate) trait Writer: Send + Sync {
    fn id(&self) -> EndpointId;
    fn audience(&self) -> Audience;
    /// Never blocks. The sample is encoded only if it leaves the process.
    fn write(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        when_full: WhenFull,
    ) -> Result<Written, Error>;
    /// Waits until every matched reliable reader has everything.
    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>>;
}

/// Keeps a subscription alive. Dropping it takes the endpoint out of the graph.
pub(crate) trait Reader: Send + Sync {
    fn id(&self) -> EndpointId;
}

/// An endpoint that discovery has seen, in this process or elsewhere.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Seen {
    pub(crate) channel: Channel,
    pub(crate) name: String,
    /// `package/msg/Type`, or `package/srv/Type` for a service.
    pub(crate) type_name: String,
    pub(crate) qos: Qos,
    pub(crate) is_writer: bool,
    pub(crate) id: EndpointId,
    /// Whether it is of this participant.
    pub(crate) is_own: bool,
    /// The hash of its type, if a publisher of another participant announces it.
    pub(crate) type_hash: Option<String>,
}

/// A middleware.
pub(crate) trait Backend: Send + Sync {
    /// The participant's own GUID.
    fn participant(&self) -> EndpointId;
    fn add_node(&self, namespace: &str, base: &str) -> Result<(), Error>;
    fn remove_node(&self, namespace: &str, base: &str);
    /// `node` is the full name of the node that the endpoint belongs to.
    fn writer(&self, node: &str, endpoint: &Endpoint) -> Result<Box<dyn Writer>, Error>;
    fn reader(&self, node: &str, endpoint: &Endpoint, sink: Sink)
    -> Result<Box<dyn Reader>, Error>;
    /// The endpoints of topics and services.
    fn seen(&self) -> Vec<Seen>;
    /// How many endpoints of others this one is connected to.
    fn matched(&self, endpoint: &EndpointId) -> usize;
    /// How many of those are of a different implementation than this suite's.
    fn foreign(&self, endpoint: &EndpointId) -> usize;
    /// Why endpoints of others on the same topic are not connected to this one, in words.
    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String>;
    /// Counts changes of what is seen and matched.
    fn changes(&self) -> watch::Receiver<u64>;
    /// Why it no longer receives or sends as it should. Once that is so, it stays so.
    fn failure(&self) -> Option<Error>;
    /// Waits until what the last writers that were dropped have sent is handed over, a moment at most. To be called while
    /// the runtime still runs.
    fn settle(&self);
    /// Leaves the graph. Readers and writers that are still held do nothing from then on.
    fn close(&self);
}
