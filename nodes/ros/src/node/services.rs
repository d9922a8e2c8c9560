//! Services: their servers and clients.

use super::{Inner, Node};
use crate::{
    Error, Qos,
    backend::{Channel, Endpoint, Reader, Sink, Writer},
    lifecycle::Gate,
    mailbox::Mailbox,
    names::TypeName,
    service::{self, Client, RawClient, RawService, Refusals, Refuse, Service, WAITING_CALLS},
};
use std::sync::{Arc, PoisonError};
use wm_msgs::cdr;

/// QoS of a service's two topics, as in rclcpp.
const SERVICE_QOS: Qos = Qos::reliable(10);

/// Services.
impl Node {
    /// Serves `S`; read the calls from the returned service.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn service<S: wm_msgs::Service>(&self, name: &str) -> Result<Service<S>, Error> {
        self.inner.interfaces.service::<S>();
        let raw = self
            .inner
            .service(name, type_of_service::<S>(), true, None)?;
        Ok(Service::new(raw))
    }

    /// As [`service`](Self::service), for a managed node: while it is not active, and if a call is dropped without an
    /// answer, the client gets the answer of `refuse` with the reason.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn service_or_refuse<S: wm_msgs::Service>(
        &self,
        name: &str,
        refuse: impl Fn(&str) -> S::Response + Send + Sync + 'static,
    ) -> Result<Service<S>, Error> {
        self.inner.interfaces.service::<S>();
        let refuse: Refuse = Box::new(move |reason| cdr::to_bytes(&refuse(reason)));
        let refusing = self.gate.clone().map(|gate| (gate, refuse));
        let raw = self
            .inner
            .service(name, type_of_service::<S>(), true, refusing)?;
        Ok(Service::new(raw))
    }

    /// Serves a service of any type, `package/srv/Type`, as CDR bytes, only for clients of other participants.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_service_for_others(&self, name: &str, type_name: &str) -> Result<RawService, Error> {
        self.inner
            .service(name, TypeName::parse_service(type_name)?, false, None)
    }

    /// Serves `S` with a handler until the node ends. The handler runs on the context's receiving thread, so it must be
    /// quick; for longer work, read the calls of [`service`](Self::service).
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn serve<S: wm_msgs::Service>(
        &self,
        name: &str,
        handler: impl Fn(S::Request) -> S::Response + Send + 'static,
    ) -> Result<(), Error> {
        self.inner.interfaces.service::<S>();
        let answer = move |request: &[u8]| cdr::to_bytes(&handler(cdr::from_bytes(request)?));
        self.inner.serve_bytes(name, type_of_service::<S>(), answer)
    }

    /// A client of the service `S` of this name.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn client<S: wm_msgs::Service>(&self, name: &str) -> Result<Client<S>, Error> {
        self.inner.interfaces.service::<S>();
        let raw = self.inner.client(name, type_of_service::<S>())?;
        Ok(Client::new(raw))
    }

    /// A client of the service of this name and of any type, `package/srv/Type`, as CDR bytes.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_client(&self, name: &str, type_name: &str) -> Result<RawClient, Error> {
        self.inner.client(name, TypeName::parse_service(type_name)?)
    }
}

impl Inner {
    pub(super) fn service(
        &self,
        name: &str,
        type_name: TypeName,
        receives_own: bool,
        refusing: Option<(Gate, Refuse)>,
    ) -> Result<RawService, Error> {
        let name = self.name.resolve(name, "service")?;
        let calls = Arc::new(Mailbox::new(WAITING_CALLS));
        let writer = self.answers(&name, type_name.clone())?;
        let refusals = refusing.map(|(gate, refuse)| {
            let (calls, writer) = (Arc::clone(&calls), Arc::clone(&writer));
            Refusals::new(name.clone(), gate, calls, writer, refuse)
        });
        let sink = match &refusals {
            Some(refusals) => service::refusing_sink(refusals),
            None => service::call_sink(name.clone(), Arc::clone(&calls)),
        };
        let reader = self.requests(name.clone(), type_name, receives_own, sink)?;
        Ok(RawService::new(
            name,
            calls,
            writer,
            reader,
            self.context.shutdown(),
            refusals,
        ))
    }

    pub(super) fn client(&self, name: &str, type_name: TypeName) -> Result<RawClient, Error> {
        let name = self.name.resolve(name, "service")?;
        let writer = self.writer(Channel::Request, &name, type_name.clone(), SERVICE_QOS)?;
        let pending = service::Pending::default();
        let sink = service::answer_sink(writer.id(), Arc::clone(&pending));
        let endpoint = Endpoint {
            channel: Channel::Response,
            name,
            type_info: self.interfaces.info(&type_name.to_string()),
            type_name,
            qos: SERVICE_QOS,
            receives_own: true,
            has_siblings: false,
        };
        let reader = self
            .backend()
            .reader(&self.name.fully_qualified, &endpoint, sink)?;
        let backend = Arc::clone(self.backend());
        Ok(RawClient::new(
            endpoint.name,
            writer,
            reader,
            pending,
            backend,
            self.context.shutdown(),
        ))
    }

    /// Serves a service as bytes until the node ends.
    pub(super) fn serve_bytes(
        &self,
        name: &str,
        type_name: TypeName,
        answer: impl Fn(&[u8]) -> Result<Vec<u8>, cdr::CdrError> + Send + 'static,
    ) -> Result<(), Error> {
        let reader = self.answering(name, type_name, answer)?;
        self.kept
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(reader);
        Ok(())
    }

    /// Serves a service as bytes on the receiving thread until the reader is dropped.
    pub(super) fn answering(
        &self,
        name: &str,
        type_name: TypeName,
        answer: impl Fn(&[u8]) -> Result<Vec<u8>, cdr::CdrError> + Send + 'static,
    ) -> Result<Box<dyn Reader>, Error> {
        let name = self.name.resolve(name, "service")?;
        let writer = self.answers(&name, type_name.clone())?;
        let sink = service::answering_sink(name.clone(), writer, answer);
        self.requests(name, type_name, true, sink)
    }

    /// The writer of a server's answers. `name` is resolved.
    pub(super) fn answers(
        &self,
        name: &str,
        type_name: TypeName,
    ) -> Result<Arc<dyn Writer>, Error> {
        let writer = self.writer(Channel::Response, name, type_name, SERVICE_QOS)?;
        Ok(Arc::from(writer))
    }

    /// The reader of a server's calls. `name` is resolved.
    pub(super) fn requests(
        &self,
        name: String,
        type_name: TypeName,
        receives_own: bool,
        sink: Sink,
    ) -> Result<Box<dyn Reader>, Error> {
        let endpoint = Endpoint {
            channel: Channel::Request,
            name,
            type_info: self.interfaces.info(&type_name.to_string()),
            type_name,
            qos: SERVICE_QOS,
            receives_own,
            has_siblings: false,
        };
        self.backend()
            .reader(&self.name.fully_qualified, &endpoint, sink)
    }
}

fn type_of_service<S: wm_msgs::Service>() -> TypeName {
    TypeName::service(S::PACKAGE, S::NAME)
}
