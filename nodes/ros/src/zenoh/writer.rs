//! The sending ends: publishers, the requests of a client, and the answers of a server.

use super::{
    apart::{DroppedApart, apart},
    attachment::Attachment,
    graph::OwnEndpoint,
    shared::{Declared, Shared},
};
use crate::{
    Durability, Error, Qos, Reliability,
    backend::{
        Audience, Channel, Endpoint, EndpointId, RequestId, Sample, WhenFull, WriteOutcome, Writer,
    },
    clock::system_nanos,
    lock::lock,
    payload::Payload,
};
use bytes::Bytes;
use futures::future::{BoxFuture, FutureExt as _};
use std::{
    sync::{
        Arc, Mutex, Weak,
        atomic::{AtomicBool, AtomicI64, Ordering},
    },
    time::{Duration, Instant},
};
use zenoh::{
    Wait as _,
    bytes::ZBytes,
    liveliness::LivelinessToken,
    matching::{MatchingListener, MatchingStatus},
    qos::CongestionControl,
    query::{ConsolidationMode, Querier, QueryTarget, Reply},
    sample::Locality,
};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig, MissDetectionConfig,
};

/// How soon a late subscription learns that it missed the last sample, as in rmw_zenoh.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// How long Zenoh keeps a call that no server answers. The caller decides when it gives up.
const CALL_TIMEOUT: Duration = Duration::from_secs(u32::MAX as u64);

/// Little-endian CDR.
const CDR: [u8; 2] = [0, 1];

/// A call or an answer is encoded in any case.
const ANYWHERE: Audience = Audience {
    here: true,
    elsewhere: true,
};

/// Zenoh has none to wait for.
fn no_acknowledgements<'a>() -> BoxFuture<'a, Result<(), Error>> {
    futures::future::ready(Ok(())).boxed()
}

/// The part that all writers have.
struct Core {
    id: EndpointId,
    endpoint: Endpoint,
    shared: Arc<Shared>,
}

impl Core {
    fn failed(&self, action: &str, error: zenoh::Error) -> Error {
        Error::middleware(format!("{action} {}", self.endpoint.name), error)
    }

    fn attachment(&self, sequence: i64, sender: EndpointId) -> ZBytes {
        let sent = system_nanos();
        Attachment {
            sequence,
            sent,
            sender,
        }
        .to_bytes()
    }

    /// The bytes of a sample that leaves the process.
    fn bytes(&self, payload: &Payload) -> Result<Bytes, Error> {
        let bytes = payload.cdr()?;
        match bytes.first_chunk::<2>() {
            Some(representation) if *representation == CDR => Ok(bytes),
            other => Err(Error::Representation {
                topic: self.endpoint.name.clone(),
                representation: other.map_or(0xffff, |bytes| u16::from_be_bytes(*bytes)),
            }),
        }
    }

    fn deliver_here(&self, sequence: i64, payload: &Payload, answers: Option<RequestId>) {
        let local = &self.shared.local;
        local.deliver(self.id, sequence, payload, answers);
    }
}

impl Drop for Core {
    fn drop(&mut self) {
        self.shared.local.remove(&self.id);
        self.shared.graph.remove_own(&self.id);
    }
}

/// Whether Zenoh has a route from an endpoint of this session to others. A token may arrive before it.
struct Route {
    is_there: Arc<AtomicBool>,
    shared: Weak<Shared>,
}

impl Route {
    fn new(own: &OwnEndpoint, shared: &Arc<Shared>) -> Self {
        own.is_routed.store(false, Ordering::Relaxed);
        Self {
            is_there: Arc::clone(&own.is_routed),
            shared: Arc::downgrade(shared),
        }
    }

    fn listener(&self) -> impl Fn(MatchingStatus) + Send + Sync + 'static {
        let (is_there, shared) = (Arc::clone(&self.is_there), Weak::clone(&self.shared));
        move |status| {
            is_there.store(status.matching(), Ordering::Relaxed);
            if let Some(shared) = shared.upgrade() {
                shared.graph.changed();
            }
        }
    }

    /// Takes the status at the declaration. The listener reports every later one, and may have done so already.
    fn is_there_if(&self, is_matching: bool) {
        self.is_there.fetch_or(is_matching, Ordering::Relaxed);
    }
}

/// A publisher.
pub(super) struct TopicWriter {
    declared: DroppedApart<DeclaredPublisher>,
    /// Whether Zenoh has a route to a subscription of another session.
    is_routed: Arc<AtomicBool>,
    numbers: Mutex<Numbers>,
    core: Core,
}

/// A publisher in Zenoh. Fields are dropped in this order: it leaves the graph first.
struct DeclaredPublisher {
    _token: LivelinessToken,
    _listener: MatchingListener<()>,
    publisher: AdvancedPublisher<'static>,
}

/// The numbers of the last samples. Without a subscription elsewhere a sample is not sent, so the two differ.
#[derive(Default)]
struct Numbers {
    sent: i64,
    here: i64,
}

impl DeclaredPublisher {
    fn new(declared: &Declared<'_>, qos: Qos, route: &Route) -> zenoh::Result<Self> {
        let publisher = declared.session.declare_publisher(declared.key.clone());
        let mut builder = publisher
            .congestion_control(CongestionControl::Drop)
            .reliability(match qos.reliability {
                Reliability::Reliable => zenoh::qos::Reliability::Reliable,
                Reliability::BestEffort => zenoh::qos::Reliability::BestEffort,
            })
            .allowed_destination(Locality::Remote)
            .advanced();
        if qos.durability == Durability::TransientLocal {
            let kept = CacheConfig::default().max_samples(qos.depth.max(1));
            builder = builder.cache(kept).publisher_detection();
            if qos.reliability == Reliability::Reliable {
                let beat = MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT);
                builder = builder.sample_miss_detection(beat);
            }
        }
        let publisher = builder.wait()?;
        let listener = publisher.matching_listener();
        let listener = listener.callback(route.listener()).wait()?;
        route.is_there_if(publisher.matching_status().wait()?.matching());
        let token = declared.session.liveliness();
        let token = token.declare_token(declared.token.clone()).wait()?;
        Ok(Self {
            _token: token,
            _listener: listener,
            publisher,
        })
    }
}

impl TopicWriter {
    pub(super) fn new(
        shared: &Arc<Shared>,
        node: &str,
        endpoint: &Endpoint,
    ) -> Result<Self, Error> {
        let declared = shared.declare(node, endpoint, true)?;
        let own = OwnEndpoint::new(endpoint, true);
        let route = Route::new(&own, shared);
        let made = apart(|| DeclaredPublisher::new(&declared, endpoint.qos, &route))?;
        let made =
            made.map_err(|error| Error::middleware(format!("publish {}", endpoint.name), error))?;
        shared.add_own(declared.id, own);
        Ok(Self {
            declared: DroppedApart::new(made),
            is_routed: route.is_there,
            numbers: Mutex::default(),
            core: Core {
                id: declared.id,
                endpoint: endpoint.clone(),
                shared: Arc::clone(shared),
            },
        })
    }

    /// Late subscriptions elsewhere take the samples of a latched topic.
    fn is_sent(&self) -> bool {
        let is_latched = self.core.endpoint.qos.durability == Durability::TransientLocal;
        !self.core.shared.is_closed() && (is_latched || self.is_routed.load(Ordering::Relaxed))
    }
}

impl Writer for TopicWriter {
    fn id(&self) -> EndpointId {
        self.core.id
    }

    fn audience(&self) -> Audience {
        let here = self.core.shared.local.matched(&self.core.id) > 0;
        // the local history of a latched topic holds messages
        let is_latched = self.core.endpoint.qos.durability == Durability::TransientLocal;
        Audience {
            here: here || is_latched,
            elsewhere: self.is_sent(),
        }
    }

    /// Zenoh has no acknowledgements: a sample for which a link has no room within its time limit is dropped by Zenoh,
    /// and the subscription counts it.
    fn write(
        &self,
        payload: &Payload,
        _: Option<RequestId>,
        _: WhenFull,
    ) -> Result<WriteOutcome, Error> {
        let mut numbers = lock(&self.numbers);
        if self.is_sent()
            && let Some(declared) = self.declared.get()
        {
            let bytes = self.core.bytes(payload)?;
            numbers.sent += 1;
            let attachment = self.core.attachment(numbers.sent, self.core.id);
            let put = declared.publisher.put(bytes).attachment(attachment).wait();
            put.map_err(|error| self.core.failed("publish", error))?;
        }
        numbers.here += 1;
        self.core.deliver_here(numbers.here, payload, None);
        Ok(WriteOutcome::Sent {
            number: numbers.here,
            dropped: 0,
        })
    }

    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>> {
        no_acknowledgements()
    }
}

/// The sending end of a client.
pub(super) struct RequestWriter {
    declared: DroppedApart<DeclaredQuerier>,
    last: AtomicI64,
    core: Core,
}

/// A client in Zenoh. Fields are dropped in this order: it leaves the graph first.
struct DeclaredQuerier {
    _token: LivelinessToken,
    _listener: MatchingListener<()>,
    querier: Querier<'static>,
}

impl DeclaredQuerier {
    fn new(declared: &Declared<'_>, route: &Route) -> zenoh::Result<Self> {
        let querier = declared
            .session
            .declare_querier(declared.key.clone())
            .target(QueryTarget::AllComplete)
            .consolidation(ConsolidationMode::None)
            .timeout(CALL_TIMEOUT)
            .allowed_destination(Locality::Remote)
            .wait()?;
        let listener = querier.matching_listener();
        let listener = listener.callback(route.listener()).wait()?;
        route.is_there_if(querier.matching_status().wait()?.matching());
        let token = declared.session.liveliness();
        let token = token.declare_token(declared.token.clone()).wait()?;
        Ok(Self {
            _token: token,
            _listener: listener,
            querier,
        })
    }
}

impl RequestWriter {
    pub(super) fn new(
        shared: &Arc<Shared>,
        node: &str,
        endpoint: &Endpoint,
    ) -> Result<Self, Error> {
        let declared = shared.declare(node, endpoint, true)?;
        let own = OwnEndpoint::new(endpoint, true);
        let route = Route::new(&own, shared);
        let made = apart(|| DeclaredQuerier::new(&declared, &route))?;
        let made =
            made.map_err(|error| Error::middleware(format!("call {}", endpoint.name), error))?;
        shared.add_own(declared.id, own);
        Ok(Self {
            declared: DroppedApart::new(made),
            last: AtomicI64::new(0),
            core: Core {
                id: declared.id,
                endpoint: endpoint.clone(),
                shared: Arc::clone(shared),
            },
        })
    }
}

impl Writer for RequestWriter {
    fn id(&self) -> EndpointId {
        self.core.id
    }

    fn audience(&self) -> Audience {
        ANYWHERE
    }

    fn write(
        &self,
        payload: &Payload,
        _: Option<RequestId>,
        _: WhenFull,
    ) -> Result<WriteOutcome, Error> {
        let number = self.last.fetch_add(1, Ordering::Relaxed) + 1;
        let core = &self.core;
        if !core.shared.is_closed()
            && let Some(declared) = self.declared.get()
        {
            let bytes = core.bytes(payload)?;
            let (shared, id) = (Arc::downgrade(&core.shared), core.id);
            let answers = Endpoint {
                channel: Channel::Response,
                ..core.endpoint.clone()
            };
            let get = declared.querier.get().payload(bytes);
            let get = get.attachment(core.attachment(number, id));
            let called = get.callback(move |reply| {
                let Some(shared) = shared.upgrade() else {
                    return;
                };
                match answer(&reply, id) {
                    Ok(sample) => shared.local.receive(&answers, &sample),
                    Err(reason) => {
                        tracing::warn!("{}: an answer is skipped: {reason}", answers.name);
                    }
                }
            });
            called.wait().map_err(|error| core.failed("call", error))?;
        }
        core.deliver_here(number, payload, None);
        Ok(WriteOutcome::Sent { number, dropped: 0 })
    }

    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>> {
        no_acknowledgements()
    }
}

/// The answer in a reply to a request of `client`.
fn answer(reply: &Reply, client: EndpointId) -> Result<Sample, String> {
    let sample = reply.result().map_err(|error| {
        let text = error.payload().to_bytes();
        format!("the server reports: {}", String::from_utf8_lossy(&text))
    })?;
    let attachment = Attachment::read(sample.attachment())?;
    if attachment.sender != client {
        return Err("it belongs to a call of another client".to_owned());
    }
    Ok(Sample {
        payload: Payload::Cdr(sample.payload().to_bytes().into_owned().into()),
        writer: attachment.sender,
        sequence: attachment.sequence,
        arrived: Instant::now(),
        request: Some(RequestId {
            client,
            sequence: attachment.sequence,
        }),
    })
}

/// The sending end of a server.
pub(super) struct ResponseWriter {
    key: String,
    core: Core,
}

impl ResponseWriter {
    pub(super) fn new(
        shared: &Arc<Shared>,
        node: &str,
        endpoint: &Endpoint,
    ) -> Result<Self, Error> {
        // the server's reader of requests declares its token
        let declared = shared.declare(node, endpoint, true)?;
        shared.add_own(declared.id, OwnEndpoint::new(endpoint, true));
        Ok(Self {
            key: declared.key,
            core: Core {
                id: declared.id,
                endpoint: endpoint.clone(),
                shared: Arc::clone(shared),
            },
        })
    }
}

impl Writer for ResponseWriter {
    fn id(&self) -> EndpointId {
        self.core.id
    }

    fn audience(&self) -> Audience {
        ANYWHERE
    }

    fn write(
        &self,
        payload: &Payload,
        answers: Option<RequestId>,
        _: WhenFull,
    ) -> Result<WriteOutcome, Error> {
        let core = &self.core;
        let Some(request) = answers else {
            let name = &core.endpoint.name;
            return Err(Error::middleware(
                format!("answer {name}"),
                "no request is named",
            ));
        };
        let query = core.shared.calls.take(&request);
        let number = request.sequence;
        match query {
            Some(query) if !core.shared.is_closed() => {
                let reply = query.reply(self.key.as_str(), core.bytes(payload)?);
                let reply = reply.attachment(core.attachment(number, request.client));
                reply.wait().map_err(|error| core.failed("answer", error))?;
            }
            _ => core.deliver_here(number, payload, Some(request)),
        }
        Ok(WriteOutcome::Sent { number, dropped: 0 })
    }

    fn acknowledged(&self) -> BoxFuture<'_, Result<(), Error>> {
        no_acknowledgements()
    }
}
