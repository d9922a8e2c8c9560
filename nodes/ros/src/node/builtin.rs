//! The endpoints of every ROS 2 node (services of parameters, loggers and types, `/parameter_events`, `/rosout`,
//! `/clock`), and the diagnostics of every node of this suite, once a second.

use super::Node;
use crate::{
    Clock, Descriptor, Error, NodeArgs, Qos,
    backend::{Backend, Channel, DiscoveredEndpoint, Endpoint, EndpointId, Reader, WhenFull},
    diagnostics::Graph,
    logging::{self, levels},
    names::TypeName,
    parameters::{Change, Parameters, services},
    payload::Payload,
    value::Value,
};
use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};
use wm_msgs::{
    Service,
    cdr::{self, CdrError},
    diagnostic_msgs::DiagnosticArray,
    rcl_interfaces::{
        DescribeParameters, GetLoggerLevels, GetParameterTypes, GetParameters, ListParameters, Log,
        ParameterEvent, SetLoggerLevels, SetParameters, SetParametersAtomically,
    },
    rosgraph_msgs,
    std_msgs::Header,
};

/// The QoS of rclcpp for `/parameter_events` and `/rosout`, with a depth that a node of this suite fills in minutes.
const PARAMETER_EVENTS_QOS: Qos = Qos::reliable(100);
const ROSOUT_QOS: Qos = Qos::latched(100);
const CLOCK_QOS: Qos = Qos::best_effort(1);
const DIAGNOSTICS_QOS: Qos = Qos::reliable(10);
const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);

/// Starts them.
pub(super) fn start(node: &Node, args: &NodeArgs) -> Result<(), Error> {
    rosout(node, args)?;
    parameter_events(node)?;
    follow_clock(node);
    node.declare(
        "use_sim_time",
        false,
        Descriptor::new("Whether the node's clock follows /clock instead of the system clock."),
    )?;
    parameter_services(node)?;
    logger_services(node)?;
    type_service(node)?;
    diagnostics(node)
}

fn rosout(node: &Node, args: &NodeArgs) -> Result<(), Error> {
    let inner = &node.inner;
    let writer = match args.rosout {
        true => Some({
            inner.interfaces.message::<Log>();
            inner.writer(
                Channel::Topic,
                "/rosout",
                TypeName::message("rcl_interfaces", "Log"),
                ROSOUT_QOS,
            )?
        }),
        false => None,
    };
    let registration = logging::register(inner.name.logger(), writer);
    *inner.rosout.lock().unwrap_or_else(PoisonError::into_inner) = Some(registration);
    Ok(())
}

fn parameter_events(node: &Node) -> Result<(), Error> {
    let inner = &node.inner;
    inner.interfaces.message::<ParameterEvent>();
    let type_name = TypeName::message("rcl_interfaces", "ParameterEvent");
    let writer = inner.writer(
        Channel::Topic,
        "/parameter_events",
        type_name,
        PARAMETER_EVENTS_QOS,
    )?;
    let (name, clock) = (inner.name.fully_qualified.clone(), inner.clock.clone());
    inner.parameters.add_observer(Box::new(move |change| {
        let event = services::event(&name, clock.now(), change);
        let sent = cdr::to_bytes(&event)
            .map_err(Error::from)
            .and_then(|bytes| {
                writer.write(&Payload::Cdr(bytes.into()), None, WhenFull::DropOldest)
            });
        if let Err(error) = sent {
            tracing::warn!("cannot publish a parameter change: {error}");
        }
    }));
    Ok(())
}

/// Subscribes to `/clock` when `use_sim_time` becomes true, and stops when it becomes false.
fn follow_clock(node: &Node) {
    let inner = &node.inner;
    let (backend, name) = (
        Arc::downgrade(inner.backend()),
        inner.name.fully_qualified.clone(),
    );
    let clock = inner.clock.clone();
    let type_name = TypeName::message("rosgraph_msgs", "Clock");
    let type_info = inner.interfaces.info(&type_name.to_string());
    let reader: Mutex<Option<Box<dyn Reader>>> = Mutex::default();
    inner
        .parameters
        .add_observer(Box::new(move |change: &Change| {
            let is_simulated = change.values.iter().find_map(|(name, value)| match value {
                Value::Bool(value) if name == "use_sim_time" => Some(*value),
                _ => None,
            });
            let (Some(is_simulated), Some(backend)) = (is_simulated, backend.upgrade()) else {
                return;
            };
            let mut reader = reader.lock().unwrap_or_else(PoisonError::into_inner);
            if is_simulated == reader.is_some() {
                return;
            }
            clock.set_simulated(is_simulated);
            *reader = None;
            if is_simulated {
                let endpoint = Endpoint {
                    channel: Channel::Topic,
                    name: "/clock".to_owned(),
                    type_name: type_name.clone(),
                    type_info: type_info.clone(),
                    qos: CLOCK_QOS,
                    receives_own: true,
                    has_siblings: false,
                };
                match backend.reader(&name, &endpoint, clock_sink(clock.clone())) {
                    Ok(subscribed) => *reader = Some(subscribed),
                    Err(error) => {
                        tracing::error!("use_sim_time is set, but there is no clock: {error}");
                    }
                }
            }
        }));
}

fn clock_sink(clock: Clock) -> crate::backend::Sink {
    Box::new(move |sample| {
        match sample.map(|sample| sample.payload.into_message::<rosgraph_msgs::Clock>()) {
            Ok(Ok(message)) => clock.advance(message.clock),
            Ok(Err(error)) => tracing::warn!("/clock: a sample is skipped: {error}"),
            Err(reason) => tracing::warn!("/clock: a sample is skipped: {reason}"),
        }
    })
}

fn parameter_services(node: &Node) -> Result<(), Error> {
    serve::<GetParameters>(node, "~/get_parameters", |parameters, request| {
        services::get(parameters, &request)
    })?;
    serve::<GetParameterTypes>(node, "~/get_parameter_types", |parameters, request| {
        services::get_types(parameters, &request)
    })?;
    serve::<DescribeParameters>(node, "~/describe_parameters", |parameters, request| {
        services::describe(parameters, &request)
    })?;
    serve::<ListParameters>(node, "~/list_parameters", |parameters, request| {
        services::list(parameters, &request)
    })?;
    serve::<SetParameters>(node, "~/set_parameters", services::set)?;
    serve::<SetParametersAtomically>(
        node,
        "~/set_parameters_atomically",
        services::set_atomically,
    )
}

fn serve<S: Service>(
    node: &Node,
    name: &str,
    handler: impl Fn(&Parameters, S::Request) -> S::Response + Send + 'static,
) -> Result<(), Error> {
    let parameters = Arc::clone(&node.inner.parameters);
    node.serve::<S>(name, move |request| handler(&parameters, request))
}

/// The services of rclcpp's option `enable_logger_service`. Every node has them, since they cost nothing.
fn logger_services(node: &Node) -> Result<(), Error> {
    node.serve::<GetLoggerLevels>("~/get_logger_levels", |request| levels::get(&request.names))?;
    node.serve::<SetLoggerLevels>("~/set_logger_levels", |request| {
        levels::set(&request.levels)
    })
}

fn type_service(node: &Node) -> Result<(), Error> {
    let descriptor = Descriptor::new("Whether the node has the service ~/get_type_description.");
    let is_wanted = node.declare(
        "start_type_description_service",
        true,
        descriptor.read_only(),
    )?;
    if !is_wanted.get() {
        return Ok(());
    }
    let interfaces = Arc::clone(&node.inner.interfaces);
    let type_name = TypeName::service("type_description_interfaces", "GetTypeDescription");
    let answer = move |request: &[u8]| -> Result<Vec<u8>, CdrError> {
        cdr::to_bytes(&interfaces.answer(&cdr::from_bytes(request)?))
    };
    node.inner
        .serve_bytes("~/get_type_description", type_name, answer)
}

/// The graph for the diagnostics.
struct Of<'a>(&'a dyn Backend);

impl Graph for Of<'_> {
    fn matched(&self, endpoint: &EndpointId) -> usize {
        self.0.matched(endpoint)
    }

    fn foreign(&self, endpoint: &EndpointId) -> usize {
        self.0.foreign(endpoint)
    }

    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String> {
        self.0.mismatches(endpoint)
    }

    fn published_alike(&self, endpoint: &EndpointId) -> BTreeSet<String> {
        let seen = self.0.seen();
        let Some(own) = seen.iter().find(|seen| seen.id == *endpoint) else {
            return BTreeSet::new();
        };
        let is_alike = |seen: &&DiscoveredEndpoint| {
            let is_its_type = seen.channel == own.channel && seen.type_name == own.type_name;
            seen.is_writer && is_its_type && seen.name != own.name
        };
        let alike = seen.iter().filter(is_alike);
        alike.map(|seen| seen.name.clone()).collect()
    }
}

fn diagnostics(node: &Node) -> Result<(), Error> {
    let publisher = node.publisher::<DiagnosticArray>("/diagnostics", DIAGNOSTICS_QOS)?;
    let (diagnostics, clock) = (node.diagnostics(), node.clock());
    let backend = Arc::clone(node.inner.backend());
    let beat = node.inner.context.runtime().spawn(async move {
        let mut beat = tokio::time::interval(DIAGNOSTICS_PERIOD);
        beat.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            beat.tick().await;
            match logging::take_dropped() {
                0 => {}
                dropped => diagnostics.count_drops("unread log lines", dropped),
            }
            let status = diagnostics.report(Instant::now(), &Of(&*backend));
            diagnostics.say_news();
            let header = Header {
                stamp: clock.now(),
                frame_id: String::new(),
            };
            if let Err(error) = publisher.publish(&DiagnosticArray { header, status }) {
                tracing::warn!("cannot publish diagnostics: {error}");
            }
        }
    });
    *node
        .inner
        .reporting
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = Some(beat.abort_handle());
    Ok(())
}
