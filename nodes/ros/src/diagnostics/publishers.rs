//! The publishers of a node's inputs, and topics that could replace a missing input.

use super::{Graph, watchdog::Publishers};
use crate::backend::EndpointId;
use std::collections::{BTreeMap, BTreeSet};

/// The graph for the watchdog, by the names of the node's inputs.
pub(super) struct PublishersOf<'a> {
    endpoints: &'a BTreeMap<EndpointId, (String, bool)>,
    /// The node's namespace, which its suite shares; empty for none.
    namespace: &'a str,
    graph: &'a dyn Graph,
}

impl<'a> PublishersOf<'a> {
    /// For the node `name` (`wm/encoder`) with these endpoints: topics, and whether it publishes them.
    pub(super) fn new(
        name: &'a str,
        endpoints: &'a BTreeMap<EndpointId, (String, bool)>,
        graph: &'a dyn Graph,
    ) -> Self {
        Self {
            endpoints,
            namespace: name.rsplit_once('/').map_or("", |(namespace, _)| namespace),
            graph,
        }
    }

    /// The subscriptions of `topic`.
    fn subscriptions(&self, topic: &str) -> impl Iterator<Item = &EndpointId> {
        let own = self.endpoints.iter();
        own.filter(move |(_, (name, is_publisher))| !is_publisher && name == topic)
            .map(|(id, _)| id)
    }
}

impl Publishers for PublishersOf<'_> {
    fn connected(&self, topic: &str) -> usize {
        let ids = self.subscriptions(topic);
        ids.map(|id| self.graph.matched(id)).sum()
    }

    fn elsewhere(&self, topic: &str) -> BTreeSet<String> {
        let ids = self.subscriptions(topic);
        let alike = ids.flat_map(|id| self.graph.published_alike(id));
        alike.filter(|name| self.is_from_outside(name)).collect()
    }

    fn is_from_outside(&self, topic: &str) -> bool {
        let rest = topic.strip_prefix('/').unwrap_or(topic);
        let inside = rest.strip_prefix(self.namespace);
        self.namespace.is_empty() || inside.is_none_or(|rest| !rest.starts_with('/'))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Pairs;
    use super::*;

    #[test]
    fn a_missing_input_names_the_topics_that_could_be_it() {
        let endpoints = BTreeMap::from([([1; 16], ("/image".to_owned(), false))]);
        for (name, expected) in [
            ("wm/encoder", &["/front"][..]),
            ("encoder", &["/front", "/wm/predicted"]),
        ] {
            let publishers = PublishersOf::new(name, &endpoints, &Pairs);
            let elsewhere = publishers.elsewhere("/image");
            assert!(elsewhere.iter().eq(expected), "{name}: {elsewhere:?}");
            assert_eq!(
                (
                    publishers.elsewhere("/other").len(),
                    publishers.connected("/image")
                ),
                (0, 2)
            );
        }
    }
}
