//! The newest diagnostics of each node, bounded.

use crate::clip;
use serde::Serialize;
use std::collections::BTreeMap;
use wm_msgs::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus};

/// The most nodes.
const MAX_NODES: usize = 64;
/// The most values of a node.
const MAX_VALUES: usize = 80;
/// Bytes of a text of the diagnostics.
const MAX_TEXT: usize = 600;
/// A node that is silent for this long is forgotten \[ns\].
const FORGOTTEN_NS: i64 = 60_000_000_000;

/// The newest diagnostics of each node.
#[derive(Debug, Default)]
pub(crate) struct Nodes(BTreeMap<String, Node>);

#[derive(Debug)]
struct Node {
    level: u8,
    message: String,
    values: Vec<(String, String)>,
    heard_ns: i64,
}

impl Nodes {
    pub(crate) fn update(&mut self, array: &DiagnosticArray, now_ns: i64) {
        self.0
            .retain(|_, node| now_ns.saturating_sub(node.heard_ns) < FORGOTTEN_NS);
        for status in &array.status {
            let name = clip::text(&status.name, MAX_TEXT);
            if self.0.len() < MAX_NODES || self.0.contains_key(&name) {
                self.0.insert(name, Node::of(status, now_ns));
            }
        }
    }

    /// Whether a node of this name has reported, in any namespace.
    pub(crate) fn has(&self, name: &str) -> bool {
        let is_it = |node: &String| node.rsplit('/').next() == Some(name);
        self.0.keys().any(is_it)
    }

    pub(crate) fn json(&self, now_ns: i64) -> Vec<NodeJson<'_>> {
        let nodes = self.0.iter().map(|(name, node)| NodeJson {
            name,
            level: node.level,
            message: &node.message,
            values: &node.values,
            age_ms: now_ns.saturating_sub(node.heard_ns) / 1_000_000,
        });
        nodes.collect()
    }
}

impl Node {
    fn of(status: &DiagnosticStatus, heard_ns: i64) -> Self {
        let values = status.values.iter().take(MAX_VALUES);
        Self {
            level: status.level,
            message: clip::text(&status.message, MAX_TEXT),
            values: values
                .map(|pair| {
                    (
                        clip::text(&pair.key, MAX_TEXT),
                        clip::text(&pair.value, MAX_TEXT),
                    )
                })
                .collect(),
            heard_ns,
        }
    }
}

/// A node as the page receives it.
#[derive(Serialize)]
pub(crate) struct NodeJson<'a> {
    name: &'a str,
    level: u8,
    message: &'a str,
    values: &'a [(String, String)],
    age_ms: i64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::diagnostic_msgs::KeyValue;

    #[test]
    fn nodes_are_bounded_and_forgotten() {
        let status = |name: String| DiagnosticStatus {
            name,
            message: "x".repeat(10_000),
            values: vec![KeyValue::default(); 1000],
            ..DiagnosticStatus::default()
        };
        let array = |status| DiagnosticArray {
            status,
            ..DiagnosticArray::default()
        };
        let mut nodes = Nodes::default();
        let many = (0..1000).map(|number| status(format!("wm/{number}")));
        nodes.update(&array(many.collect()), 1);
        assert_eq!(nodes.json(2).len(), MAX_NODES);
        assert!(nodes.has("0") && !nodes.has("999"));
        let text = serde_json::to_string(&nodes.json(2)).unwrap();
        let limit = MAX_NODES * (MAX_TEXT + 20 * MAX_VALUES + 200);
        assert!(text.len() < limit, "{}", text.len());
        nodes.update(&array(vec![status("wm/new".to_owned())]), 2 + FORGOTTEN_NS);
        assert_eq!(nodes.json(2 + FORGOTTEN_NS).len(), 1);
    }
}
