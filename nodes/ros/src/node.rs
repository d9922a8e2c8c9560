//! A node: its name in the graph, and its endpoints there.

mod actions;
mod builtin;
mod coverage;
mod description;
mod graph;
mod interfaces;
mod overrides;
mod services;

pub use graph::{RemoteEndpoint, Role, TopicInfo};

use coverage::{Coverage, Decoding};
use interfaces::Interfaces;

use crate::{
    Clock, Context, Descriptor, Diagnostics, Durability, Error, NodeArgs, Parameter, Publisher,
    Qos, RawPublisher, RawSubscription, Reliability, Shutdown, Subscription,
    backend::{Backend, Channel, Endpoint, Reader, TypeInfo, Writer},
    lifecycle::Gate,
    logging,
    names::{NodeName, TypeName},
    parameters::Parameters,
    subscription::{FurtherReader, Intake, PublisherKind},
    value::{ParameterType, Value},
};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::task::AbortHandle;
use wm_msgs::{Message, builtin_interfaces::Time};

/// A ROS 2 node. Clones are handles of the same node, which leaves the graph when the last one is dropped.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
    /// The gate of the endpoints made by this handle.
    gate: Option<Gate>,
}

struct Inner {
    name: NodeName,
    context: Context,
    parameters: Arc<Parameters>,
    clock: Clock,
    diagnostics: Diagnostics,
    /// The types that the node uses.
    interfaces: Arc<Interfaces>,
    /// Readers that live as long as the node: services with a handler, `/clock`.
    kept: Mutex<Vec<Box<dyn Reader>>>,
    /// The task that publishes the diagnostics once a second.
    reporting: Mutex<Option<AbortHandle>>,
    /// Publishes its records on `/rosout`.
    rosout: Mutex<Option<logging::Registration>>,
}

impl Node {
    /// Makes a node. Its name and namespace are the defaults, unless the command line has `__node` and `__ns`.
    ///
    /// The node has the six parameter services, `/parameter_events`, `/rosout`, the services of loggers and types, the
    /// parameter `use_sim_time`, and diagnostics once a second, as soon as this returns.
    ///
    /// # Errors
    /// A name that ROS does not allow, a `use_sim_time` that is not a bool, or the middleware failed.
    pub fn new(
        context: &Context,
        default_name: &str,
        default_namespace: &str,
        args: &NodeArgs,
    ) -> Result<Self, Error> {
        let name = NodeName::new(default_name, default_namespace, &args.remaps)?;
        context.backend().add_node(&name.namespace, &name.base)?;
        let inner = Inner {
            parameters: Arc::new(Parameters::new(&name.fully_qualified, &args.overrides)),
            clock: Clock::new(),
            diagnostics: Diagnostics::new(&name.fully_qualified),
            context: context.clone(),
            interfaces: Arc::default(),
            kept: Mutex::default(),
            reporting: Mutex::default(),
            rosout: Mutex::default(),
            name,
        };
        let node = Self {
            inner: Arc::new(inner),
            gate: None,
        };
        builtin::start(&node, args)?;
        Ok(node)
    }

    /// A handle of the same node; its endpoints are silent while the gate is closed.
    pub(crate) fn behind(&self, gate: &Gate) -> Self {
        Self {
            inner: Arc::clone(&self.inner),
            gate: Some(gate.clone()),
        }
    }

    /// A handle of the same node; its endpoints have no gate.
    fn ungated(&self) -> Self {
        Self {
            inner: Arc::clone(&self.inner),
            gate: None,
        }
    }

    /// Opens the gate of endpoints that were made [`behind`](Self::behind) it.
    pub(crate) fn open(&self, gate: &Gate) {
        gate.open(&**self.inner.backend());
    }

    /// The base name, for example `encoder`.
    pub fn name(&self) -> &str {
        &self.inner.name.base
    }

    /// The namespace, for example `/wm`; `/` for none.
    pub fn namespace(&self) -> &str {
        &self.inner.name.namespace
    }

    /// Namespace and name, for example `/wm/encoder`.
    pub fn fully_qualified_name(&self) -> &str {
        &self.inner.name.fully_qualified
    }

    /// The absolute name of a topic or service, with namespace and remapping.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn resolve(&self, name: &str) -> Result<String, Error> {
        self.inner.name.resolve(name, "topic or service")
    }

    /// The absolute name of the sibling `name/suffix`, as in image_transport for `compressed`: if only `name` is
    /// remapped, its sibling follows.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn resolve_sibling(&self, name: &str, suffix: &str) -> Result<String, Error> {
        self.inner.name.resolve_sibling(name, suffix, "topic")
    }

    /// The end of the context.
    pub fn shutdown(&self) -> Shutdown {
        self.inner.context.shutdown()
    }

    /// The node's diagnostics.
    pub fn diagnostics(&self) -> Diagnostics {
        self.inner.diagnostics.clone()
    }

    /// The node's clock.
    pub fn clock(&self) -> Clock {
        self.inner.clock.clone()
    }

    /// The time now, by the node's clock.
    pub fn now(&self) -> Time {
        self.inner.clock.now()
    }

    /// A span that assigns log records to this node in a process of several nodes: `future.instrument(node.span())`.
    pub fn span(&self) -> tracing::Span {
        tracing::error_span!("node", node = self.inner.name.logger())
    }
}

/// Parameters.
impl Node {
    /// Declares a parameter. Its value comes from the command line, a parameter file, or the default.
    ///
    /// # Errors
    /// The value given has a different type or is out of range, or the parameter is declared already.
    pub fn declare<T: ParameterType>(
        &self,
        name: &str,
        default: T,
        descriptor: Descriptor,
    ) -> Result<Parameter<T>, Error> {
        let parameters = &self.inner.parameters;
        let value = parameters.declare(name, default.clone().into_value(), descriptor)?;
        Ok(Parameter::new(
            name,
            &value,
            default,
            Arc::clone(parameters),
        ))
    }

    /// Call it after the last declaration: a value for an undeclared parameter is an error, or a warning if it comes
    /// from a section that other nodes share (`/**`).
    ///
    /// # Errors
    /// Names the parameter, the source of the value, and the declared parameters.
    pub fn seal_parameters(&self) -> Result<(), Error> {
        self.check_parameters(false)
    }

    /// Call it after all endpoints are made: an unused `qos_overrides` is an error, or a warning if it comes from a
    /// section that other nodes share (`/**`). For a managed node, call it after its configuration.
    ///
    /// # Errors
    /// Names the override, the source of the value, and the declared parameters.
    pub fn seal_endpoints(&self) -> Result<(), Error> {
        self.check_parameters(true)
    }

    fn check_parameters(&self, has_endpoints: bool) -> Result<(), Error> {
        for ignored in self.inner.parameters.check_all_declared(has_endpoints)? {
            tracing::warn!(
                "this node has no parameter `{}` (from {})",
                ignored.name,
                ignored.origin
            );
        }
        Ok(())
    }

    /// The value of a declared parameter.
    ///
    /// # Errors
    /// It is not declared, or of a different type.
    pub fn parameter<T: ParameterType>(&self, name: &str) -> Result<T, Error> {
        Ok(self.inner.parameters.get_typed(name)?)
    }

    /// Changes a parameter, under the same rules as the parameter services.
    ///
    /// # Errors
    /// Not declared, read-only, of a different type, out of range, or refused by a check of [`on_set`](Self::on_set).
    pub fn set_parameter<T: ParameterType>(&self, name: &str, value: T) -> Result<(), Error> {
        Ok(self
            .inner
            .parameters
            .set(vec![(name.to_owned(), value.into_value())])?)
    }

    /// Calls `check` before each change of parameters; an error refuses the change. It must not change parameters.
    pub fn on_set(
        &self,
        check: impl Fn(&[(String, Value)]) -> Result<(), String> + Send + Sync + 'static,
    ) {
        self.inner.parameters.add_check(Box::new(check));
    }
}

/// Topics.
impl Node {
    /// Publishes a topic of messages `M`.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn publisher<M: Message>(&self, topic: &str, qos: Qos) -> Result<Publisher<M>, Error> {
        self.inner.interfaces.message::<M>();
        let type_name = type_of::<M>();
        let info = self.inner.interfaces.info(&type_name.to_string());
        Ok(Publisher::new(self.publish(topic, type_name, info, qos)?))
    }

    /// Publishes a topic of any type, `package/msg/Type`, as CDR bytes.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_publisher(
        &self,
        topic: &str,
        type_name: &str,
        qos: Qos,
    ) -> Result<RawPublisher, Error> {
        let type_name = TypeName::parse_message(type_name)?;
        let info = self.inner.interfaces.described(&type_name.to_string());
        self.publish(topic, type_name, info, qos)
    }

    fn publish(
        &self,
        topic: &str,
        type_name: TypeName,
        type_info: Option<TypeInfo>,
        qos: Qos,
    ) -> Result<RawPublisher, Error> {
        let name = self.inner.name.resolve(topic, "topic")?;
        let qos = overrides::apply(
            &self.inner.parameters,
            self.fully_qualified_name(),
            &name,
            "publisher",
            qos,
        )?;
        let endpoint = Endpoint {
            channel: Channel::Topic,
            name: name.clone(),
            type_name,
            type_info,
            qos,
            receives_own: true,
            has_siblings: false,
        };
        let backend = self.inner.backend();
        let writer = backend.writer(self.fully_qualified_name(), &endpoint)?;
        Ok(RawPublisher::new(
            name,
            writer,
            Arc::clone(self.inner.backend()),
            self.diagnostics(),
            self.shutdown(),
            self.gate.clone(),
        ))
    }

    /// Subscribes to a topic of messages `M`. A best-effort request matches every publisher.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn subscription<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
    ) -> Result<Subscription<M>, Error> {
        self.subscribe_typed(topic, qos, Coverage::NEW)
    }

    /// As [`subscription`](Self::subscription), and it also receives latched samples (durability transient local): for
    /// messages that are valid until the next one, for example goals. Unlike with [`Qos::latched`], volatile publishers
    /// are connected too.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn subscription_catching_up<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
    ) -> Result<Subscription<M>, Error> {
        self.subscribe_typed(topic, qos, Coverage::LATCHED)
    }

    /// As [`subscription_catching_up`](Self::subscription_catching_up), and best-effort publishers are connected too:
    /// for messages that must arrive with any quality of service of their publisher, for example an emergency stop.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn subscription_to_any<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
    ) -> Result<Subscription<M>, Error> {
        self.subscribe_typed(topic, qos, Coverage::ANY)
    }

    fn subscribe_typed<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
        coverage: Coverage,
    ) -> Result<Subscription<M>, Error> {
        self.inner.interfaces.message::<M>();
        let decoding = Decoding::Here;
        let raw = self.subscribe(topic, type_of::<M>(), qos, coverage, decoding)?;
        Ok(Subscription::new(raw))
    }

    /// Subscribes to a topic of any type, `package/msg/Type`, as CDR bytes.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_subscription(
        &self,
        topic: &str,
        type_name: &str,
        qos: Qos,
    ) -> Result<RawSubscription, Error> {
        self.subscribe(
            topic,
            TypeName::parse_message(type_name)?,
            qos,
            Coverage::NEW,
            Decoding::ByReader,
        )
    }

    /// As [`subscription_catching_up`](Self::subscription_catching_up), of any type, `package/msg/Type`, as CDR bytes.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_subscription_catching_up(
        &self,
        topic: &str,
        type_name: &str,
        qos: Qos,
    ) -> Result<RawSubscription, Error> {
        self.subscribe(
            topic,
            TypeName::parse_message(type_name)?,
            qos,
            Coverage::LATCHED,
            Decoding::ByReader,
        )
    }

    /// As [`subscription_to_any`](Self::subscription_to_any), of any type, `package/msg/Type`, as CDR bytes.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_subscription_to_any(
        &self,
        topic: &str,
        type_name: &str,
        qos: Qos,
    ) -> Result<RawSubscription, Error> {
        self.subscribe(
            topic,
            TypeName::parse_message(type_name)?,
            qos,
            Coverage::ANY,
            Decoding::ByReader,
        )
    }

    /// As [`raw_subscription`](Self::raw_subscription), but without the samples of this context: for a program
    /// that carries a topic both ways.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_subscription_to_others(
        &self,
        topic: &str,
        type_name: &str,
        qos: Qos,
    ) -> Result<RawSubscription, Error> {
        self.subscribe(
            topic,
            TypeName::parse_message(type_name)?,
            qos,
            Coverage::OTHERS,
            Decoding::ByReader,
        )
    }

    fn subscribe(
        &self,
        topic: &str,
        type_name: TypeName,
        qos: Qos,
        coverage: Coverage,
        decoding: Decoding,
    ) -> Result<RawSubscription, Error> {
        let name = self.inner.name.resolve(topic, "topic")?;
        let qos = overrides::apply(
            &self.inner.parameters,
            self.fully_qualified_name(),
            &name,
            "subscription",
            qos,
        )?;
        let intake = Intake::new(
            name.clone(),
            qos.depth,
            self.diagnostics(),
            self.clock(),
            self.gate.clone(),
        );
        let type_text = type_name.to_string();
        let mut type_info = self.inner.interfaces.info(&type_text);
        if let (Some(info), Decoding::ByReader) = (&mut type_info, decoding) {
            info.hash = None;
        }
        let (latched, best_effort) = (
            coverage.latched && qos.durability == Durability::Volatile,
            coverage.best_effort && qos.reliability == Reliability::Reliable,
        );
        let endpoint = Endpoint {
            channel: Channel::Topic,
            name,
            type_info,
            type_name,
            qos,
            receives_own: coverage.own,
            has_siblings: best_effort,
        };
        let (backend, node) = (self.inner.backend(), self.fully_qualified_name());
        if !backend.excludes_by_qos() {
            return self.subscribe_once(endpoint, intake, latched);
        }
        let sink = match latched || best_effort {
            true => intake.sink_of_two(),
            false => intake.sink(),
        };
        let reader = backend.reader(node, &endpoint, sink)?;
        let further = [
            latched.then(|| (PublisherKind::Latching, intake.sink_of_latched(backend))),
            best_effort.then(|| {
                (
                    PublisherKind::BestEffort,
                    intake.sink_of_best_effort(backend),
                )
            }),
        ];
        let further = further.into_iter().flatten().map(|(kind, sink)| {
            let runtime = self.inner.context.runtime();
            let (node, endpoint) = (node.to_owned(), endpoint.clone());
            FurtherReader::begin(runtime, backend, node, endpoint, kind, sink)
        });
        let further = further.collect();
        Ok(RawSubscription::new(
            intake,
            reader,
            Arc::clone(backend),
            self.shutdown(),
            type_text,
            further,
        ))
    }

    /// With one reader, which receives from every publisher, and with `latched` also samples older than itself.
    fn subscribe_once(
        &self,
        mut endpoint: Endpoint,
        intake: Arc<Intake>,
        latched: bool,
    ) -> Result<RawSubscription, Error> {
        let (backend, node) = (self.inner.backend(), self.fully_qualified_name());
        let sink = match latched {
            true => {
                endpoint.qos.durability = Durability::TransientLocal;
                intake.sink_of_any(backend)
            }
            false => intake.sink(),
        };
        let reader = backend.reader(node, &endpoint, sink)?;
        Ok(RawSubscription::new(
            intake,
            reader,
            Arc::clone(backend),
            self.shutdown(),
            endpoint.type_name.to_string(),
            Vec::new(),
        ))
    }
}

impl Inner {
    fn backend(&self) -> &Arc<dyn Backend> {
        self.context.backend()
    }

    fn writer(
        &self,
        channel: Channel,
        name: &str,
        type_name: TypeName,
        qos: Qos,
    ) -> Result<Box<dyn Writer>, Error> {
        let endpoint = Endpoint {
            channel,
            name: name.to_owned(),
            type_info: self.interfaces.info(&type_name.to_string()),
            type_name,
            qos,
            receives_own: true,
            has_siblings: false,
        };
        self.backend().writer(&self.name.fully_qualified, &endpoint)
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        let reporting = self
            .reporting
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(reporting) = reporting {
            reporting.abort();
        }
        self.rosout
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        self.kept
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
        self.backend()
            .remove_node(&self.name.namespace, &self.name.base);
    }
}

fn type_of<M: Message>() -> TypeName {
    TypeName::message(M::PACKAGE, M::NAME)
}
