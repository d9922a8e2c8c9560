//! A node as data: name, purpose, parameters, topics, services, and entry points. The command line, the help and the
//! parameter files are made from it.

mod graph_node;
mod help;
mod params_file;

pub use graph_node::{GraphEndpoint, GraphNode};

use crate::{Component, Direction, EndpointSpec, Node, NodeArgs, ParameterSpec, lifecycle};
use futures::future::LocalBoxFuture;
use std::process::ExitCode;

/// Topics that a node chooses at run time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChosenTopics {
    /// None: its endpoints are all.
    None,
    /// It subscribes to topics that it discovers, and calls `get_type_description` of their publishers.
    Subscribed,
    /// It publishes topics of a file.
    Published,
}

/// A node, before it runs. Made by [`of`](Self::of) from a [`NodeProgram`](crate::NodeProgram).
#[derive(Clone, Copy)]
pub struct NodeDefinition<E> {
    /// The node's default name, and its command's.
    pub name: &'static str,
    /// Its purpose, in one line.
    pub about: &'static str,
    /// Its parameters, without those that every node has.
    pub parameters: fn() -> Vec<ParameterSpec>,
    /// Its topics and services, without those that every node has.
    pub endpoints: fn() -> Vec<EndpointSpec>,
    /// Topics beyond these endpoints.
    pub chosen_topics: ChosenTopics,
    /// Whether it has a lifecycle ([`Lifecycle`](crate::Lifecycle)).
    pub is_managed: bool,
    /// Whether it is the only node of its process.
    pub runs_alone: bool,
    /// Runs it until it ends or a signal arrives.
    pub run: fn(&NodeArgs) -> Result<ExitCode, E>,
    /// The node in a process that may run other nodes too.
    pub body: fn(Node) -> LocalBoxFuture<'static, Result<(), E>>,
}

impl<E: 'static> NodeDefinition<E> {
    /// The node for a process with others; `None` if it [runs alone](Self::runs_alone).
    pub fn component(&self) -> Option<Component<E>> {
        (!self.runs_alone).then(|| Component::new(self.name, self.body))
    }
}

impl<E> NodeDefinition<E> {
    /// All parameters except those of every ROS node.
    fn specs(&self) -> Vec<ParameterSpec> {
        let mut specs = (self.parameters)();
        if self.is_managed {
            specs.insert(0, lifecycle::autostart());
        }
        specs
    }

    /// Topics of one direction, or services.
    fn endpoints_of(&self, direction: Direction) -> Vec<EndpointSpec> {
        let mut specs = (self.endpoints)();
        specs.retain(|spec| spec.direction == direction);
        specs
    }
}
