//! Services: servers that answer calls, and clients.

use crate::{
    Error, Shutdown,
    backend::{
        Backend, EndpointId, Reader, RequestId, Sample, Sink, WhenFull, WriteOutcome, Writer,
    },
    lifecycle::{Gate, GatedEndpoint},
    mailbox::Mailbox,
    payload::Payload,
    waiting_call::{Arrival, WaitingCall},
};
use bytes::Bytes;
use std::{
    collections::BTreeMap,
    marker::PhantomData,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};
use tokio::sync::oneshot;
use wm_msgs::cdr;

/// The most calls that wait for a server. Policy DropOldest: the client of the oldest has most likely given up.
pub(crate) const WAITING_CALLS: usize = 64;

/// The serving end of a service of any type: requests and answers as CDR bytes with their 4-byte header.
pub struct RawService {
    name: String,
    calls: Arc<Mailbox<WaitingCall>>,
    writer: Arc<dyn Writer>,
    _reader: Box<dyn Reader>,
    shutdown: Shutdown,
    /// Set for a service that refuses calls while its managed node is not active.
    refusals: Option<Arc<Refusals>>,
}

/// A call of a [`RawService`] to be answered.
pub struct RawCall {
    /// The request, as CDR.
    pub request: Bytes,
    service: String,
    id: RequestId,
    writer: Arc<dyn Writer>,
    refusal: Refusal,
}

/// The refusal of a call, sent if the call is dropped without an answer, since its client waits for one.
struct Refusal(Option<(Arc<Refusals>, RequestId)>);

impl Drop for Refusal {
    fn drop(&mut self) {
        if let Some((refusals, id)) = self.0.take() {
            refusals.send(id);
        }
    }
}

/// Refuses the calls of a managed node that is not active.
pub(crate) struct Refusals {
    name: String,
    gate: Gate,
    calls: Arc<Mailbox<WaitingCall>>,
    writer: Arc<dyn Writer>,
    refuse: Refuse,
}

/// Makes the answer that refuses a call, as CDR, from the reason.
pub(crate) type Refuse = Box<dyn Fn(&str) -> Result<Vec<u8>, cdr::CdrError> + Send + Sync>;

impl Refusals {
    pub(crate) fn new(
        name: String,
        gate: Gate,
        calls: Arc<Mailbox<WaitingCall>>,
        writer: Arc<dyn Writer>,
        refuse: Refuse,
    ) -> Arc<Self> {
        let refusals = Arc::new(Self {
            name,
            gate,
            calls,
            writer,
            refuse,
        });
        let gated: Arc<dyn GatedEndpoint> = refusals.clone();
        refusals.gate.add(Arc::downgrade(&gated));
        refusals
    }

    fn send(&self, id: RequestId) {
        let reason = format!("{}: the node is not active", self.name);
        let sent = (self.refuse)(&reason)
            .map_err(Error::from)
            .and_then(|answer| send(&*self.writer, &self.name, answer.into(), id));
        if let Err(error) = sent {
            tracing::debug!("{}: a call is not refused: {error}", self.name);
        }
    }

    fn refuse_waiting(&self) {
        while let Some(call) = self.calls.try_pop() {
            self.send(call.id);
        }
    }
}

impl GatedEndpoint for Refusals {
    fn opened(&self, _: &dyn Backend) {
        self.refuse_waiting();
    }

    fn closed(&self) {
        self.refuse_waiting();
    }
}

/// As [`call_sink`], but refuses calls at once while the node is not active.
pub(crate) fn refusing_sink(refusals: &Arc<Refusals>) -> Sink {
    let refusals = Arc::clone(refusals);
    let mut sink = call_sink(refusals.name.clone(), Arc::clone(&refusals.calls));
    Box::new(move |sample| match sample {
        Ok(Sample {
            request: Some(id), ..
        }) if !refusals.gate.is_open() => refusals.send(id),
        sample => sink(sample),
    })
}

/// The serving end of a service `S`.
pub struct Service<S> {
    raw: RawService,
    of: PhantomData<fn(S)>,
}

/// A call to be answered.
pub struct Call<S: wm_msgs::Service> {
    /// The request.
    pub request: S::Request,
    raw: RawCall,
}

/// A sink that adds calls to a mailbox.
pub(crate) fn call_sink(name: String, calls: Arc<Mailbox<WaitingCall>>) -> Sink {
    Box::new(move |sample| match sample {
        Ok(Sample {
            payload,
            request: Some(id),
            ..
        }) => {
            let request = match payload.into_cdr() {
                Ok(request) => request,
                Err(error) => {
                    tracing::warn!("{name}: a call is skipped: {error}");
                    return;
                }
            };
            let arrival = Instant::now();
            if !calls.push(WaitingCall {
                id,
                request,
                arrival,
            }) {
                tracing::warn!(
                    "{name}: more than {WAITING_CALLS} calls wait, the oldest is dropped"
                );
            }
        }
        Ok(Sample { request: None, .. }) => {
            tracing::warn!("{name}: a call without an identity cannot be answered");
        }
        Err(reason) => tracing::warn!("{name}: a call is skipped: {reason}"),
    })
}

/// A sink that answers calls on the receiving thread.
pub(crate) fn answering_sink(
    name: String,
    writer: Arc<dyn Writer>,
    answer: impl Fn(&[u8]) -> Result<Vec<u8>, cdr::CdrError> + Send + 'static,
) -> Sink {
    Box::new(move |sample| {
        let Ok(Sample {
            payload,
            request: Some(id),
            ..
        }) = sample
        else {
            tracing::warn!("{name}: a call that cannot be read or answered is skipped");
            return;
        };
        let answered = payload
            .into_cdr()
            .and_then(|request| answer(&request))
            .map_err(Error::from)
            .and_then(|answer| send(&*writer, &name, answer.into(), id));
        if let Err(error) = answered {
            tracing::warn!("{name}: a call is not answered: {error}");
        }
    })
}

pub(crate) fn send(
    writer: &dyn Writer,
    name: &str,
    answer: Bytes,
    id: RequestId,
) -> Result<(), Error> {
    match writer.write(&Payload::Cdr(answer), Some(id), WhenFull::DropOldest)? {
        WriteOutcome::Sent { .. } | WriteOutcome::Held => Ok(()),
        WriteOutcome::WindowFull => Err(Error::middleware(
            format!("answer {name}"),
            "clients do not take their answers",
        )),
    }
}

impl RawService {
    pub(crate) fn new(
        name: String,
        calls: Arc<Mailbox<WaitingCall>>,
        writer: Arc<dyn Writer>,
        reader: Box<dyn Reader>,
        shutdown: Shutdown,
        refusals: Option<Arc<Refusals>>,
    ) -> Self {
        Self {
            name,
            calls,
            writer,
            _reader: reader,
            shutdown,
            refusals,
        }
    }

    /// Waits for a call; `None` once the context is shut down. Cancel safe.
    pub async fn recv(&mut self) -> Option<RawCall> {
        let WaitingCall { id, request, .. } = tokio::select! {
            biased;
            () = self.shutdown.wait() => return None,
            call = self.calls.pop() => call?,
        };
        Some(RawCall {
            request,
            service: self.name.clone(),
            id,
            writer: Arc::clone(&self.writer),
            refusal: Refusal(self.refusals.clone().map(|refusals| (refusals, id))),
        })
    }

    /// When its oldest waiting call arrived.
    pub(crate) fn arrival(&self) -> Arrival {
        Arrival(Arc::clone(&self.calls))
    }

    /// The service's absolute name.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl RawCall {
    /// The GUID of the client and the number of the call, together unique in the whole graph.
    pub fn id(&self) -> ([u8; 16], i64) {
        (self.id.client, self.id.sequence)
    }

    /// Answers the call with little-endian CDR.
    ///
    /// # Errors
    /// The bytes are not little-endian CDR, or the middleware failed.
    pub fn respond(mut self, response: Bytes) -> Result<(), Error> {
        self.refusal.0 = None;
        send(&*self.writer, &self.service, response, self.id)
    }
}

impl<S: wm_msgs::Service> Service<S> {
    pub(crate) fn new(raw: RawService) -> Self {
        Self {
            raw,
            of: PhantomData,
        }
    }

    /// Waits for a call; `None` once the context is shut down. Cancel safe. A call of another type is reported and
    /// skipped.
    pub async fn recv(&mut self) -> Option<Call<S>> {
        loop {
            let raw = self.raw.recv().await?;
            match cdr::from_bytes(&raw.request) {
                Ok(request) => return Some(Call { request, raw }),
                Err(error) => tracing::warn!("{}: a call is skipped: {error}", self.name()),
            }
        }
    }

    /// When its oldest waiting call arrived.
    pub(crate) fn arrival(&self) -> Arrival {
        self.raw.arrival()
    }

    /// Waits until every connected client has acknowledged its answers; `false` after `timeout`.
    ///
    /// # Errors
    /// The middleware failed.
    pub async fn wait_for_acknowledgments(&self, timeout: Duration) -> Result<bool, Error> {
        match tokio::time::timeout(timeout, self.raw.writer.acknowledged()).await {
            Ok(done) => done.map(|()| true),
            Err(_elapsed) => Ok(false),
        }
    }

    /// The service's absolute name.
    pub fn name(&self) -> &str {
        self.raw.name()
    }
}

impl<S: wm_msgs::Service> Call<S> {
    /// The GUID of the client; [`Node::node_of_client`](crate::Node::node_of_client) may know the name of its node.
    pub fn client(&self) -> [u8; 16] {
        self.raw.id.client
    }

    /// Answers the call.
    ///
    /// # Errors
    /// The response has no CDR form, or the middleware failed.
    pub fn respond(self, response: &S::Response) -> Result<(), Error> {
        self.raw.respond(cdr::to_bytes(response)?.into())
    }
}

/// Awaited answers, by the number of their request.
pub(crate) type Pending = Arc<Mutex<BTreeMap<i64, oneshot::Sender<Bytes>>>>;

/// The calling end of a service of any type: requests and answers as CDR bytes with their 4-byte header.
pub struct RawClient {
    name: String,
    writer: Box<dyn Writer>,
    reader: Box<dyn Reader>,
    pending: Pending,
    backend: Arc<dyn Backend>,
    shutdown: Shutdown,
}

/// The calling end of a service `S`.
pub struct Client<S> {
    raw: RawClient,
    of: PhantomData<fn(S)>,
}

/// A sink that hands answers to the waiting calls; it ignores answers to other clients.
pub(crate) fn answer_sink(client: EndpointId, pending: Pending) -> Sink {
    Box::new(move |sample| {
        if let Ok(Sample {
            payload,
            request: Some(id),
            ..
        }) = sample
            && id.client == client
            && let Ok(bytes) = payload.into_cdr()
        {
            let waiting = pending
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .remove(&id.sequence);
            if let Some(waiting) = waiting {
                waiting.send(bytes).ok();
            }
        }
    })
}

/// Removes a request from the list when its caller stops waiting.
struct PendingEntry<'a> {
    pending: &'a Pending,
    sequence: i64,
}

impl Drop for PendingEntry<'_> {
    fn drop(&mut self) {
        self.pending
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .remove(&self.sequence);
    }
}

impl RawClient {
    pub(crate) fn new(
        name: String,
        writer: Box<dyn Writer>,
        reader: Box<dyn Reader>,
        pending: Pending,
        backend: Arc<dyn Backend>,
        shutdown: Shutdown,
    ) -> Self {
        Self {
            name,
            writer,
            reader,
            pending,
            backend,
            shutdown,
        }
    }

    /// Calls the service and waits for the answer without a limit: add a timeout.
    ///
    /// # Errors
    /// The request is not little-endian CDR, the middleware failed, or the context is shut down.
    pub async fn call(&self, request: Bytes) -> Result<Bytes, Error> {
        let (answer, _waiting) = {
            // Locked during the write, so that the answer cannot arrive before its entry exists.
            let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
            let payload = Payload::Cdr(request);
            let sequence = match self.writer.write(&payload, None, WhenFull::DropOldest)? {
                WriteOutcome::Sent { number, .. } => number,
                WriteOutcome::Held | WriteOutcome::WindowFull => {
                    return Err(Error::middleware(
                        format!("call {}", self.name),
                        "the server takes no calls",
                    ));
                }
            };
            let (sender, answer) = oneshot::channel();
            pending.insert(sequence, sender);
            (
                answer,
                PendingEntry {
                    pending: &self.pending,
                    sequence,
                },
            )
        };
        tokio::select! {
            answer = answer => match answer {
                Ok(bytes) => Ok(bytes),
                Err(_) => Err(Error::ShutDown(self.name.clone())),
            },
            () = self.shutdown.wait() => Err(Error::ShutDown(self.name.clone())),
        }
    }

    /// Waits until a server is connected.
    pub async fn wait_for_service(&self) {
        let mut changes = self.backend.changes();
        let (requests, responses) = (self.writer.id(), self.reader.id());
        while !self.backend.has_server(&requests, &responses) {
            if changes.changed().await.is_err() {
                return;
            }
        }
    }

    /// The service's absolute name.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl<S: wm_msgs::Service> Client<S> {
    pub(crate) fn new(raw: RawClient) -> Self {
        Self {
            raw,
            of: PhantomData,
        }
    }

    /// Calls the service and waits for the answer without a limit: add a timeout.
    ///
    /// # Errors
    /// The middleware failed, the answer has another type, or the context is shut down.
    pub async fn call(&self, request: &S::Request) -> Result<S::Response, Error> {
        let answer = self.raw.call(cdr::to_bytes(request)?.into()).await?;
        Ok(cdr::from_bytes(&answer)?)
    }

    /// Waits until a server is connected.
    pub async fn wait_for_service(&self) {
        self.raw.wait_for_service().await;
    }

    /// The service's absolute name.
    pub fn name(&self) -> &str {
        self.raw.name()
    }
}
