//! Rights on the command line: `NAME=publish:/topic,call:/service`.

use super::identity::{Identity, check_name};
use anyhow::{Result, bail, ensure};
use std::{collections::BTreeSet, str::FromStr};
use wm_ros::{GraphEndpoint, GraphNode, Role};

/// Services that only report.
const REPORTING: [&str; 10] = [
    "describe_parameters",
    "get_available_states",
    "get_available_transitions",
    "get_logger_levels",
    "get_parameter_types",
    "get_parameters",
    "get_state",
    "get_transition_graph",
    "get_type_description",
    "list_parameters",
];

/// The nodes of the `ros2` command, with a process id or a word after it.
const COMMAND_LINE_NODES: &str = "_ros2cli_$*";

/// A name and its rights.
#[derive(Clone, Debug)]
pub(super) struct Grant {
    name: String,
    endpoints: BTreeSet<GraphEndpoint>,
}

impl FromStr for Grant {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let Some((name, words)) = text.split_once('=') else {
            bail!("expected NAME=GRANTS");
        };
        check_name(name)?;
        // no endpoints of a node: only what is granted
        let mut node = GraphNode {
            name: name.to_owned(),
            endpoints: BTreeSet::new(),
        };
        for word in words.split(',').map(str::trim) {
            add(&mut node, word)?;
        }
        Ok(Self {
            name: node.name,
            endpoints: node.endpoints,
        })
    }
}

fn add(node: &mut GraphNode, word: &str) -> Result<()> {
    let (verb, name) = word.split_once(':').unwrap_or((word, ""));
    match (verb, name) {
        ("read", "") => {
            node.add(Role::Subscription, "/**".to_owned());
            for service in REPORTING {
                node.add(Role::Client, format!("/**/{service}"));
            }
            return Ok(());
        }
        ("all", "") => {
            for role in [
                Role::Publisher,
                Role::Subscription,
                Role::Server,
                Role::Client,
            ] {
                node.add(role, "/**".to_owned());
            }
            return Ok(());
        }
        _ => check_pattern(name, word)?,
    }
    match verb {
        "publish" => node.add(Role::Publisher, name.to_owned()),
        "subscribe" => node.add(Role::Subscription, name.to_owned()),
        "serve" => node.add(Role::Server, name.to_owned()),
        "call" => node.add(Role::Client, name.to_owned()),
        "perform" => node.add_action(true, name),
        "send" => node.add_action(false, name),
        _ => bail!(
            "`{word}`: expected publish, subscribe, serve, call, perform or send with :NAME, read or all"
        ),
    }
    Ok(())
}

/// An absolute name with `*` and `**` as parts.
fn check_pattern(name: &str, word: &str) -> Result<()> {
    let is_part = |part: &str| {
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        matches!(part, "*" | "**") || (!part.is_empty() && part.chars().all(is_name))
    };
    let parts = name.strip_prefix('/').map(|rest| rest.split('/'));
    ensure!(
        parts.is_some_and(|mut parts| parts.all(is_part)),
        "`{word}`: expected an absolute name, for example publish:/camera/image_raw or subscribe:/camera/**"
    );
    Ok(())
}

impl Grant {
    /// Adds the rights to the identity of this name, or makes one for a node of another package. A name without a
    /// slash is one in this namespace.
    ///
    /// # Errors
    /// A name that ROS does not allow for a node.
    pub(super) fn apply(&self, identities: &mut Vec<Identity>, namespace: &str) -> Result<()> {
        let full_name = match self.name.starts_with('/') {
            true => self.name.clone(),
            false => format!("{}/{}", namespace.trim_end_matches('/'), self.name),
        };
        if let Some(known) = identities.iter_mut().find(|known| known.name == full_name) {
            known.endpoints.extend(self.endpoints.iter().cloned());
            known.lacks_topics = false;
            return Ok(());
        }
        let mut identity = Identity::new(full_name.clone(), vec![GraphNode::new(&full_name)?]);
        identity.endpoints.extend(self.endpoints.iter().cloned());
        identities.push(identity);
        Ok(())
    }

    /// The identity of a tool: nodes of any name.
    pub(super) fn tool(&self) -> Identity {
        let mut endpoints = self.endpoints.clone();
        for (role, topic) in [
            (Role::Subscription, "/clock"),
            (Role::Publisher, "/parameter_events"),
            (Role::Subscription, "/parameter_events"),
            (Role::Publisher, "/rosout"),
        ] {
            let name = topic.to_owned();
            endpoints.insert(GraphEndpoint { role, name });
        }
        let name = format!("/{COMMAND_LINE_NODES}/*");
        let role = Role::Server;
        endpoints.insert(GraphEndpoint { role, name });
        Identity {
            name: self.name.clone(),
            nodes: None,
            endpoints,
            lacks_topics: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn has(identity: &Identity, role: Role, name: &str) -> bool {
        identity.names(role).any(|known| known == name)
    }

    #[test]
    fn foreign_node_has_what_is_granted_and_what_every_node_has() {
        let grant: Grant = "/camera/driver=publish:/camera/**, send:/wm/planner/plan"
            .parse()
            .unwrap();
        let mut identities = Vec::new();
        grant.apply(&mut identities, "/wm").unwrap();
        let driver = &identities[0];
        assert_eq!(driver.nodes, Some(vec!["/camera/driver".to_owned()]));
        assert!(has(driver, Role::Publisher, "/camera/**"));
        assert!(has(
            driver,
            Role::Client,
            "/wm/planner/plan/_action/send_goal"
        ));
        assert!(has(driver, Role::Server, "/camera/driver/get_parameters"));
        assert!(!has(driver, Role::Subscription, "/camera/**"));

        let more: Grant = "/camera/driver=subscribe:/tf".parse().unwrap();
        more.apply(&mut identities, "/wm").unwrap();
        assert_eq!(identities.len(), 1);
        assert!(has(&identities[0], Role::Subscription, "/tf"));
    }

    #[test]
    fn tool_reads_and_sets_nothing() {
        let grant: Grant = "desk=read".parse().unwrap();
        let desk = grant.tool();
        assert_eq!(desk.nodes, None);
        assert!(has(&desk, Role::Subscription, "/**"));
        assert!(has(&desk, Role::Client, "/**/get_parameters"));
        assert!(!has(&desk, Role::Client, "/**/set_parameters"));
        assert!(!has(&desk, Role::Publisher, "/**"));
    }

    #[test]
    fn malformed_grants_are_refused_by_name() {
        for (text, word) in [
            ("driver", "NAME=GRANTS"),
            ("driver=", "expected"),
            ("driver=publish", "publish"),
            ("driver=publish:image", "absolute"),
            ("driver=publish:/a//b", "absolute"),
            ("driver=publish:/a/b*", "absolute"),
            ("driver=publish:/a/@adv", "absolute"),
            ("driver=watch:/a", "watch"),
            ("a+b=read", "a+b"),
            ("../key=read", "../key"),
        ] {
            let error = text.parse::<Grant>().unwrap_err().to_string();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
