//! A node: its name in the graph, and everything that it makes there.

mod actions;
mod builtin;
mod description;
mod graph;
mod interfaces;
mod overrides;
mod services;

pub use graph::{RemoteEndpoint, Role, TopicInfo};

use interfaces::Interfaces;

use crate::{
    Clock, Context, Descriptor, Diagnostics, Durability, Error, NodeArgs, Parameter, Publisher,
    Qos, RawPublisher, RawSubscription, Reliability, Shutdown, Subscription,
    backend::{Backend, Channel, Endpoint, Reader, Writer},
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

/// A ROS 2 node. Clones are handles on the same node, which leaves the graph with the last of them.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
    /// What the endpoints that this handle makes heed.
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
    /// Readers that serve for as long as the node lives: services with a handler, `/clock`.
    kept: Mutex<Vec<Box<dyn Reader>>>,
    /// The one second beat of the diagnostics.
    reporting: Mutex<Option<AbortHandle>>,
    /// Its records go to `/rosout`.
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
        let name = NodeName::new(default_name, default_namespace, args)?;
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

    /// The same node; the endpoints that this handle makes are silent while the gate is closed.
    pub(crate) fn behind(&self, gate: &Gate) -> Self {
        Self {
            inner: Arc::clone(&self.inner),
            gate: Some(gate.clone()),
        }
    }

    /// The same node; the endpoints that this handle makes heed no gate.
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

    /// The absolute name that a topic or service has after namespace and remapping.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn resolve(&self, name: &str) -> Result<String, Error> {
        self.inner.name.resolve(name, "topic or service")
    }

    /// The absolute name of the sibling `name/suffix`, as image_transport has it for `compressed`: where `name` is
    /// remapped and the sibling is not, it goes with it.
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

    /// Where the node counts what happens to it.
    pub fn diagnostics(&self) -> Diagnostics {
        self.inner.diagnostics.clone()
    }

    /// The clock that the node goes by.
    pub fn clock(&self) -> Clock {
        self.inner.clock.clone()
    }

    /// The time now, by the node's clock.
    pub fn now(&self) -> Time {
        self.inner.clock.now()
    }

    /// A span that makes log records of a process with several nodes this node's: `future.instrument(node.span())`.
    pub fn span(&self) -> tracing::Span {
        tracing::error_span!("node", node = self.inner.name.logger())
    }
}

/// Parameters.
impl Node {
    /// Declares a parameter. Its value is the one that the command line or a parameter file gives, or the default.
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

    /// To be called after the last declaration: a value that was given for no declared parameter is an error. One
    /// from a section that other nodes share (`/**`) is only warned of.
    ///
    /// # Errors
    /// Names the parameter, where it came from, and the parameters that there are.
    pub fn seal_parameters(&self) -> Result<(), Error> {
        self.check_parameters(false)
    }

    /// To be called once all endpoints are made: a `qos_overrides` that none of them took is an error, one from a
    /// section that other nodes share (`/**`) a warning. A managed node is asked when it has been configured.
    ///
    /// # Errors
    /// Names the override, where it came from, and the parameters that there are.
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

    /// Changes a parameter, under the rules that hold for everybody.
    ///
    /// # Errors
    /// Not declared, read-only, of a different type, out of range, or refused by a check of [`on_set`](Self::on_set).
    pub fn set_parameter<T: ParameterType>(&self, name: &str, value: T) -> Result<(), Error> {
        Ok(self
            .inner
            .parameters
            .set(vec![(name.to_owned(), value.into_value())])?)
    }

    /// Asks `check` before any change of parameters; what it refuses is not made. It must not change parameters.
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
        Ok(Publisher::new(self.publish(topic, type_of::<M>(), qos)?))
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
        self.publish(topic, TypeName::parse_message(type_name)?, qos)
    }

    fn publish(&self, topic: &str, type_name: TypeName, qos: Qos) -> Result<RawPublisher, Error> {
        let name = self.inner.name.resolve(topic, "topic")?;
        let qos = overrides::apply(
            &self.inner.parameters,
            self.fully_qualified_name(),
            &name,
            "publisher",
            qos,
        )?;
        let writer = self.inner.writer(Channel::Topic, &name, type_name, qos)?;
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
        self.subscribe_typed(topic, qos, Hears::default())
    }

    /// As [`subscription`](Self::subscription), and the latched samples of publishers that latch (durability transient
    /// local) are received too: for messages that are valid until the next one, as a goal. Publishers that do not latch
    /// are connected as well, unlike with [`Qos::latched`].
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn subscription_catching_up<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
    ) -> Result<Subscription<M>, Error> {
        self.subscribe_typed(
            topic,
            qos,
            Hears {
                latched: true,
                ..Hears::default()
            },
        )
    }

    /// As [`subscription_catching_up`](Self::subscription_catching_up), and best-effort publishers are connected as well:
    /// for messages that must arrive with any quality of service of their publisher, as an emergency stop.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn subscription_to_any<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
    ) -> Result<Subscription<M>, Error> {
        self.subscribe_typed(
            topic,
            qos,
            Hears {
                latched: true,
                best_effort: true,
                ..Hears::default()
            },
        )
    }

    fn subscribe_typed<M: Message>(
        &self,
        topic: &str,
        qos: Qos,
        hears: Hears,
    ) -> Result<Subscription<M>, Error> {
        self.inner.interfaces.message::<M>();
        let raw = self.subscribe(topic, type_of::<M>(), qos, hears)?;
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
        let type_name = TypeName::parse_message(type_name)?;
        self.subscribe(topic, type_name, qos, Hears::default())
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
        let hears = Hears {
            latched: true,
            ..Hears::default()
        };
        self.subscribe(topic, TypeName::parse_message(type_name)?, qos, hears)
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
        let hears = Hears {
            latched: true,
            best_effort: true,
            ..Hears::default()
        };
        self.subscribe(topic, TypeName::parse_message(type_name)?, qos, hears)
    }

    /// As [`raw_subscription`](Self::raw_subscription), but it does not hear what this context publishes: for a
    /// program that carries a topic both ways.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn raw_subscription_to_others(
        &self,
        topic: &str,
        type_name: &str,
        qos: Qos,
    ) -> Result<RawSubscription, Error> {
        let hears = Hears {
            own: false,
            ..Hears::default()
        };
        self.subscribe(topic, TypeName::parse_message(type_name)?, qos, hears)
    }

    fn subscribe(
        &self,
        topic: &str,
        type_name: TypeName,
        qos: Qos,
        hears: Hears,
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
        let (latched, best_effort) = (
            hears.latched && qos.durability == Durability::Volatile,
            hears.best_effort && qos.reliability == Reliability::Reliable,
        );
        let endpoint = Endpoint {
            channel: Channel::Topic,
            name,
            type_name,
            qos,
            hears_own: hears.own,
            has_siblings: best_effort,
        };
        let (backend, node) = (self.inner.backend(), self.fully_qualified_name());
        let sink = match latched || best_effort {
            true => intake.sink_of_two(),
            false => intake.sink(),
        };
        let reader = backend.reader(node, &endpoint, sink)?;
        let further = [
            latched.then(|| (PublisherKind::Latching, intake.sink_of_latched())),
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
}

/// What a subscription hears beside what others publish from now on.
#[derive(Clone, Copy)]
struct Hears {
    /// What this context publishes.
    own: bool,
    /// What was latched before.
    latched: bool,
    /// Best-effort publishers, although it requests reliable.
    best_effort: bool,
}

impl Default for Hears {
    fn default() -> Self {
        Self {
            own: true,
            latched: false,
            best_effort: false,
        }
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
            type_name,
            qos,
            hears_own: true,
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
