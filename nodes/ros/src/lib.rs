//! The ROS 2 runtime that the nodes share: command line, parameters, topics, services, actions, clock, logs,
//! diagnostics.
//!
//! A node written with it is an ordinary ROS 2 node: it accepts `--ros-args`, appears in `ros2 node list`, answers
//! `ros2 param`, follows `/clock`, and publishes on `/rosout` and `/diagnostics`.
//!
//! ```no_run
//! use wm_msgs::std_msgs;
//! use wm_ros::{Descriptor, Error, Node, NodeArgs, Qos};
//!
//! fn main() -> Result<(), Error> {
//!     let args = NodeArgs::parse(std::env::args().skip(1))?;
//!     wm_ros::run("shout", "/wm", &args, async |node: Node| -> Result<(), Error> {
//!         let suffix = node.declare("suffix", "!".to_owned(), Descriptor::new("what is put behind a text"))?;
//!         node.seal_parameters()?;
//!         let mut texts = node.subscription::<std_msgs::String>("text", Qos::reliable(10))?;
//!         let shouts = node.publisher::<std_msgs::String>("shout", Qos::reliable(10))?;
//!         while let Some(received) = texts.recv().await {
//!             shouts.publish(&std_msgs::String { data: received.message.data.to_uppercase() + &suffix.get() })?;
//!         }
//!         Ok(())
//!     })
//! }
//! ```
//!
//! # Concepts
//! - [`Context`]: the process's participant in the graph, with one thread that receives for all its nodes.
//! - [`Node`]: a name in the graph, which makes publishers, subscriptions, services, actions and parameters.
//! - [`ActionServer`] and [`ActionClient`]: the two ends of an action; a [`ServerGoal`] is a goal under way.
//! - [`parameters!`] and [`endpoints!`]: the parameters, topics, services and actions of a node, each declared once.
//! - [`NodeProgram`]: the trait of a node, with a whole node as its example.
//! - [`NodeDefinition`]: a node as data. Its command, its help and its parameter file are made from it.
//! - [`Lifecycle`]: makes a node managed: it is configured and activated on request.
//! - [`Shutdown`]: ends every `recv` on SIGINT and SIGTERM.
//!
//! # Promises
//! - No silent losses: queues have a named policy and count their drops; undecodable and missing samples are counted;
//!   all counts are on `/diagnostics`.
//! - Memory is bounded: subscriptions by their depth, reliable publishers by 512 samples (or their depth, if larger)
//!   and 64 MiB. A subscription that lags further loses the oldest samples; the others lose none.
//! - Messages between nodes of one [`Context`] are shared, not encoded.
//! - Loopback by default; see [`Environment`].
//!
//! # Not here
//! The nodes' computations; bags. The middlewares' types stay private: DDS and Zenoh implement the private module
//! `backend`.

mod action;
mod args;
mod backend;
mod clock;
pub mod complaints;
mod context;
mod dds;
mod definition;
mod diagnostics;
mod endpoints;
mod environment;
mod error;
mod forced_end;
pub mod frame_trace;
#[doc(hidden)]
pub mod fuzzing;
mod lifecycle;
mod local;
mod lock;
pub mod logging;
mod mailbox;
mod middleware;
mod names;
mod node;
mod parameters;
mod payload;
mod program;
mod publisher;
mod qos;
mod rcl_interfaces;
mod remap;
mod requests;
mod run;
#[cfg(feature = "zenoh")]
mod secured_session;
mod service;
mod shutdown;
mod subscription;
mod type_description_interfaces;
mod value;
mod waiting_call;
#[cfg(feature = "zenoh")]
pub mod zenoh;

pub use action::{
    ActionClient, ActionServer, ClientGoal, GoalId, GoalRequest, GoalStatus, ServerGoal,
};
pub use args::{ArgsError, LogLevels, NodeArgs};
pub use clock::Clock;
pub use context::Context;
pub use definition::{ChosenTopics, GraphEndpoint, GraphNode, NodeDefinition};
pub use diagnostics::{Deadline, Diagnostics, Input, Latency, Level};
pub use endpoints::{Direction, Endpoint, EndpointSet, EndpointSpec};
#[doc(hidden)]
pub use endpoints::{made_by, make_if};
pub use environment::{Environment, EnvironmentWarning, Interface, Reach};
pub use error::Error;
pub use lifecycle::{Lifecycle, Machine, Managed, Outcome, Refused, State, Transition};
pub use middleware::Middleware;
pub use node::{Node, RemoteEndpoint, Role, TopicInfo};
pub use parameters::{
    Descriptor, Field, Parameter, ParameterError, ParameterSet, ParameterSpec, Range,
    RemoteParameters,
};
pub use program::{NodeProgram, Setup};
pub use publisher::{Publisher, RawPublisher};
pub use qos::{Durability, Qos, Reliability};
pub use requests::{RequestEndpoint, RequestSet, RequestSource, Requests, answer};
pub use run::{Component, run, run_together};
pub use service::{Call, Client, RawCall, RawClient, RawService, Service};
pub use shutdown::Shutdown;
pub use subscription::{Gaps, PublisherId, RawSubscription, Received, Subscription};
pub use wm_msgs::rcl_interfaces::Log;

/// The default namespace of all nodes of the suite.
pub const NAMESPACE: &str = "/wm";
pub use value::{Kind, ParameterType, Value};
pub use waiting_call::Arrival;
