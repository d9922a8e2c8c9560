//! The name and the endpoints of a node in the graph, before it runs: after remapping, with the endpoints of every ROS
//! node. Access control is made from them.

use super::NodeDefinition;
use crate::{Direction, Error, NodeArgs, Role, action, names::NodeName};
use std::collections::BTreeSet;

/// The services of every node: parameters, loggers, type descriptions.
const SERVICES: [&str; 9] = [
    "describe_parameters",
    "get_logger_levels",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_logger_levels",
    "set_parameters",
    "set_parameters_atomically",
];

/// The services of a managed node.
const LIFECYCLE_SERVICES: [&str; 5] = [
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
];

/// The topics of every node. rclcpp and rclpy also subscribe to `/parameter_events`.
const TOPICS: [(Role, &str); 5] = [
    (Role::Subscription, "/clock"),
    (Role::Publisher, "/diagnostics"),
    (Role::Publisher, "/parameter_events"),
    (Role::Subscription, "/parameter_events"),
    (Role::Publisher, "/rosout"),
];

/// One endpoint in the graph.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct GraphEndpoint {
    /// Its role.
    pub role: Role,
    /// The absolute name of its topic or service.
    pub name: String,
}

/// A node and its endpoints in the graph. Actions are their three services and two topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GraphNode {
    /// The full name: `/wm/encoder`.
    pub name: String,
    /// All endpoints that it may have, the conditional ones included.
    pub endpoints: BTreeSet<GraphEndpoint>,
}

impl GraphNode {
    /// Any node of ROS 2 with this full name, and the endpoints that rclcpp and rclpy give it. It may be managed.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn new(full_name: &str) -> Result<Self, Error> {
        let (namespace, base) = full_name.rsplit_once('/').unwrap_or(("", full_name));
        Self::of(&NodeName::new(base, namespace, &[])?, true)
    }

    fn of(name: &NodeName, is_managed: bool) -> Result<Self, Error> {
        let mut node = Self {
            name: name.fully_qualified.clone(),
            endpoints: BTreeSet::new(),
        };
        for (role, topic) in TOPICS {
            node.add(role, name.resolve(topic, "topic")?);
        }
        let lifecycle: &[&str] = match is_managed {
            true => &LIFECYCLE_SERVICES,
            false => &[],
        };
        for service in SERVICES.iter().chain(lifecycle) {
            let service = name.resolve(&format!("~/{service}"), "service")?;
            node.add(Role::Server, service);
        }
        if is_managed {
            let events = name.resolve("~/transition_event", "topic")?;
            node.add(Role::Publisher, events);
        }
        Ok(node)
    }

    /// Adds the endpoint.
    pub fn add(&mut self, role: Role, name: String) {
        self.endpoints.insert(GraphEndpoint { role, name });
    }

    /// Adds the endpoints of an action: those of its server, or of a client.
    pub fn add_action(&mut self, is_server: bool, action: &str) {
        let (service, topic) = match is_server {
            true => (Role::Server, Role::Publisher),
            false => (Role::Client, Role::Subscription),
        };
        for part in ["send_goal", "cancel_goal", "get_result"] {
            self.add(service, action::part(action, part));
        }
        for part in ["feedback", "status"] {
            self.add(topic, action::part(action, part));
        }
    }
}

impl<E> NodeDefinition<E> {
    /// The node in the graph with these arguments and this default namespace. A topic that a parameter names is at its
    /// default.
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn in_graph(&self, args: &NodeArgs, namespace: &str) -> Result<GraphNode, Error> {
        let name = NodeName::new(self.name, namespace, &args.remaps)?;
        let mut node = GraphNode::of(&name, self.is_managed)?;
        for spec in (self.endpoints)() {
            let resolved = |kind| name.resolve(&spec.name, kind);
            match spec.direction {
                Direction::Subscribed => node.add(Role::Subscription, resolved("topic")?),
                Direction::Published => node.add(Role::Publisher, resolved("topic")?),
                Direction::Served => node.add(Role::Server, resolved("service")?),
                Direction::Called => node.add(Role::Client, resolved("service")?),
                Direction::Performed => node.add_action(true, &resolved("action")?),
            }
            // a sibling follows its topic, unless it has a rule of its own
            if let Some(topic) = spec.name.strip_suffix("/compressed") {
                let sibling = name.resolve_sibling(topic, "compressed", "topic")?;
                let role = match spec.direction {
                    Direction::Published => Role::Publisher,
                    _ => Role::Subscription,
                };
                node.add(role, sibling);
            }
        }
        Ok(node)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_node_has_the_endpoints_of_ros() {
        let node = GraphNode::new("/camera/driver").unwrap();
        let has = |role, name: &str| {
            let name = name.to_owned();
            node.endpoints.contains(&GraphEndpoint { role, name })
        };
        assert_eq!(node.name, "/camera/driver");
        assert!(has(Role::Publisher, "/rosout"));
        assert!(has(Role::Server, "/camera/driver/set_parameters"));
        assert!(has(Role::Server, "/camera/driver/change_state"));
        assert!(!has(Role::Subscription, "/rosout"));
        assert_eq!(GraphNode::new("/driver").unwrap().name, "/driver");
        assert_eq!(GraphNode::new("driver").unwrap().name, "/driver");
        assert!(GraphNode::new("/camera/2").is_err());
    }

    #[test]
    fn action_is_three_services_and_two_topics() {
        let mut node = GraphNode::new("/fold").unwrap();
        let before = node.endpoints.len();
        node.add_action(true, "/fold/fold");
        node.add_action(false, "/plan");
        assert_eq!(node.endpoints.len(), before + 10);
        let name = "/plan/_action/status".to_owned();
        let role = Role::Subscription;
        assert!(node.endpoints.contains(&GraphEndpoint { role, name }));
    }
}
