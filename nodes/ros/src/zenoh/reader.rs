//! The receiving ends: subscriptions, the requests of a server, and the answers of a client.

use super::{
    apart::{DroppedApart, apart},
    attachment::Attachment,
    graph::OwnEndpoint,
    key::byte_sequence_key,
    shared::{Declared, Shared},
};
use crate::{
    Durability, Error, Reliability,
    backend::{Channel, Endpoint, EndpointId, Reader, RequestId, Sample, Sink},
    local::WAITING,
    mailbox::Mailbox,
    payload::Payload,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::task::AbortHandle;
use zenoh::{
    Wait as _,
    bytes::ZBytes,
    liveliness::LivelinessToken,
    query::{Query, Queryable},
    sample::Locality,
};
use zenoh_ext::{
    AdvancedSubscriber, AdvancedSubscriberBuilderExt as _, HistoryConfig, RecoveryConfig,
};

/// How long a late subscription waits for the latched samples of a publisher.
const HISTORY_TIMEOUT: Duration = Duration::from_secs(u32::MAX as u64);

/// Samples that wait for the receiving thread.
type Inbox = Arc<Mailbox<Result<Sample, String>>>;

/// A reader of any kind.
pub(super) struct ZenohReader {
    /// `None` for the answers of a client: its writer of requests hands them over.
    _declared: Option<DroppedApart<DeclaredReader>>,
    pump: AbortHandle,
    id: EndpointId,
    shared: Arc<Shared>,
}

/// A reader in Zenoh. Fields are dropped in this order: it leaves the graph first.
struct DeclaredReader {
    _token: LivelinessToken,
    _subscribers: Vec<AdvancedSubscriber<()>>,
    _queryable: Option<Queryable<()>>,
}

impl Reader for ZenohReader {
    fn id(&self) -> EndpointId {
        self.id
    }
}

impl Drop for ZenohReader {
    fn drop(&mut self) {
        self.pump.abort();
        self.shared.local.remove(&self.id);
        self.shared.graph.remove_own(&self.id);
    }
}

impl ZenohReader {
    pub(super) fn new(
        shared: &Arc<Shared>,
        node: &str,
        endpoint: &Endpoint,
        sink: Sink,
    ) -> Result<Self, Error> {
        let action = match endpoint.channel {
            Channel::Topic => "subscribe to",
            Channel::Request => "serve",
            Channel::Response => "receive answers of",
        };
        let failed = |error| Error::middleware(format!("{action} {}", endpoint.name), error);
        let declared = shared.declare(node, endpoint, false)?;
        let inbox: Inbox = Arc::new(Mailbox::new(WAITING));
        let pump = pump(shared, declared.id, endpoint, Arc::clone(&inbox), sink);
        shared.add_own(declared.id, OwnEndpoint::new(endpoint, false));
        let mut reader = Self {
            _declared: None,
            pump,
            id: declared.id,
            shared: Arc::clone(shared),
        };
        if endpoint.channel != Channel::Response {
            let made = apart(|| DeclaredReader::new(&declared, endpoint, shared, &inbox))?;
            reader._declared = Some(DroppedApart::new(made.map_err(failed)?));
        }
        Ok(reader)
    }
}

impl DeclaredReader {
    /// A subscription or a server.
    fn new(
        declared: &Declared<'_>,
        endpoint: &Endpoint,
        shared: &Arc<Shared>,
        inbox: &Inbox,
    ) -> zenoh::Result<Self> {
        let (mut subscribers, mut served) = (Vec::new(), None);
        if endpoint.channel == Channel::Topic {
            let buffers = declared.takes_buffers;
            let buffers = buffers.then(|| byte_sequence_key(&declared.key));
            for key in std::iter::once(declared.key.clone()).chain(buffers) {
                let subscriber = subscriber(declared.session, key, endpoint, shared, inbox)?;
                subscribers.push(subscriber);
            }
        } else {
            served = Some(queryable(declared, endpoint, shared, inbox)?);
        }
        let token = declared.session.liveliness();
        let token = token.declare_token(declared.token.clone()).wait()?;
        Ok(Self {
            _token: token,
            _subscribers: subscribers,
            _queryable: served,
        })
    }
}

fn queryable(
    declared: &Declared<'_>,
    endpoint: &Endpoint,
    shared: &Arc<Shared>,
    inbox: &Inbox,
) -> zenoh::Result<Queryable<()>> {
    let (shared, inbox) = (Arc::downgrade(shared), Arc::clone(inbox));
    let name = endpoint.name.clone();
    let queryable = declared.session.declare_queryable(declared.key.clone());
    let queryable = queryable.complete(true).allowed_origin(Locality::Remote);
    let queryable = queryable.callback(move |query| {
        if let Some(shared) = shared.upgrade() {
            inbox.push(request(query, &name, &shared));
        }
    });
    queryable.wait()
}

/// Hands the samples of this process and of the inbox to the sink, on the receiving thread.
fn pump(
    shared: &Arc<Shared>,
    id: EndpointId,
    endpoint: &Endpoint,
    inbox: Inbox,
    mut sink: Sink,
) -> AbortHandle {
    let here = match endpoint.receives_own || endpoint.channel == Channel::Response {
        true => shared.local.add_reader(id, endpoint),
        false => Arc::new(Mailbox::new(1)),
    };
    let pump = async move {
        loop {
            let sample = tokio::select! {
                Some(sample) = here.pop() => Ok(sample),
                Some(sample) = inbox.pop() => sample,
                else => break,
            };
            sink(sample);
        }
    };
    shared.runtime.spawn(pump).abort_handle()
}

fn subscriber(
    session: &zenoh::Session,
    key: String,
    endpoint: &Endpoint,
    shared: &Arc<Shared>,
    inbox: &Inbox,
) -> zenoh::Result<AdvancedSubscriber<()>> {
    let (shared, inbox) = (Arc::downgrade(shared), Arc::clone(inbox));
    let subscriber = session.declare_subscriber(key).callback(move |sample| {
        let received = sample_of(sample.attachment(), sample.payload());
        let Some(shared) = shared.upgrade() else {
            return;
        };
        // a query of latched samples is answered by this session's own publishers too
        if let Ok(sample) = &received
            && shared.graph.is_own(&sample.writer)
        {
            return;
        }
        // a sample dropped here is a gap in the numbers, which the subscription counts
        inbox.push(received);
    });
    let mut subscriber = subscriber.allowed_origin(Locality::Remote).advanced();
    let qos = endpoint.qos;
    if qos.durability == Durability::TransientLocal {
        let history = HistoryConfig::default().detect_late_publishers();
        subscriber = subscriber
            .history(history.max_samples(qos.depth.max(1)))
            .query_timeout(HISTORY_TIMEOUT)
            .subscriber_detection();
        if qos.reliability == Reliability::Reliable {
            subscriber = subscriber.recovery(RecoveryConfig::default().heartbeat());
        }
    }
    subscriber.wait()
}

fn sample_of(attachment: Option<&ZBytes>, payload: &ZBytes) -> Result<Sample, String> {
    let attachment = Attachment::read(attachment)?;
    Ok(Sample {
        payload: Payload::Cdr(payload.to_bytes().into_owned().into()),
        writer: attachment.sender,
        sequence: attachment.sequence,
        arrived: Instant::now(),
        request: None,
    })
}

/// The request of a query, which then waits for its answer.
fn request(query: Query, name: &str, shared: &Shared) -> Result<Sample, String> {
    let payload = query.payload().ok_or("it has no payload")?;
    let sample = sample_of(query.attachment(), payload)?;
    let request = RequestId {
        client: sample.writer,
        sequence: sample.sequence,
    };
    if !shared.calls.add(request, query) {
        return Err(format!(
            "{name}: call {} of a client arrived twice",
            sample.sequence
        ));
    }
    Ok(Sample {
        request: Some(request),
        ..sample
    })
}
