//! Endpoints on one topic that cannot communicate: one requests more than the other offers, or their types differ. This
//! is frequent in ROS 2. So each pair is logged once, with the policy or the types, and stays on the diagnostics while
//! both exist.

use super::qos;
use crate::{backend::EndpointId, lock::lock};
use rustdds::QosPolicies;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Mutex,
};

/// Mismatches stored per own endpoint; further ones are only logged. The limit is per endpoint, so that many mismatches
/// on one topic do not hide a mismatch of an emergency stop.
const LIMIT: usize = 64;

/// Explanations, by own endpoint and remote endpoint.
type Explanations = BTreeMap<(EndpointId, EndpointId), String>;

fn of_endpoint<'a>(known: &'a Explanations, own: &EndpointId) -> impl Iterator<Item = &'a String> {
    let all = (*own, EndpointId::default())..=(*own, [u8::MAX; 16]);
    known.range(all).map(|(_, text)| text)
}

fn role(is_publisher: bool) -> &'static str {
    match is_publisher {
        true => "a publisher",
        false => "a subscription",
    }
}

#[derive(Default)]
pub(super) struct Mismatches {
    known: Mutex<Explanations>,
    /// Own readers with siblings in the same subscription; the siblings receive from the publishers that these exclude.
    tolerant: Mutex<BTreeSet<EndpointId>>,
}

impl Mismatches {
    /// A sibling of this reader receives from the publishers that its reliability or durability excludes.
    pub(super) fn tolerate(&self, own: EndpointId) {
        lock(&self.tolerant).insert(own);
        // a reader this new has no other mismatches yet
        lock(&self.known).retain(|(endpoint, _), _| *endpoint != own);
    }

    /// A remote endpoint and the own one have incompatible QoS.
    pub(super) fn policies(
        &self,
        own: EndpointId,
        other: EndpointId,
        topic: Option<String>,
        is_publisher: bool,
        (requested, offered): (&QosPolicies, &QosPolicies),
    ) {
        // `None` if the two match by now: the event is older than the change
        let Some(policy) = offered.compliance_failure_wrt(requested) else {
            return;
        };
        let is_by_profile = !qos::from_dds(requested).matches(&qos::from_dds(offered));
        if is_by_profile && lock(&self.tolerant).contains(&own) {
            return;
        }
        let topic = topic.unwrap_or_else(|| "a service".to_owned());
        let what = role(is_publisher);
        let text = format!(
            "{topic}: not connected to {what} because of incompatible {policy:?}: the subscription requests `{}`, the \
             publisher offers `{}`; change one of them, for example with qos_overrides",
            qos::from_dds(requested),
            qos::from_dds(offered)
        );
        self.insert(own, other, text);
    }

    /// A remote endpoint has a different type. rustdds connects the two anyway; other implementations do not.
    pub(super) fn types(
        &self,
        own: EndpointId,
        other: EndpointId,
        topic: &str,
        (own_type, other_type): (&str, &str),
        is_publisher: bool,
    ) {
        let what = role(is_publisher);
        let text = format!(
            "{topic}: {what} has the type {other_type}, but this node uses {own_type}: they cannot communicate"
        );
        self.insert(own, other, text);
    }

    fn insert(&self, own: EndpointId, other: EndpointId, text: String) {
        let mut known = lock(&self.known);
        let is_known = known.contains_key(&(own, other));
        let is_new = match is_known || of_endpoint(&known, &own).count() < LIMIT {
            true => known.insert((own, other), text.clone()).as_ref() != Some(&text),
            false => true,
        };
        drop(known);
        if is_new {
            tracing::warn!("{text}");
        }
    }

    /// Explains the mismatches of this endpoint.
    pub(super) fn of(&self, own: &EndpointId) -> Vec<String> {
        let known = lock(&self.known);
        let mut texts: Vec<String> = of_endpoint(&known, own).cloned().collect();
        texts.dedup();
        texts
    }

    pub(super) fn forget_own(&self, own: &EndpointId) {
        lock(&self.known).retain(|(endpoint, _), _| endpoint != own);
        lock(&self.tolerant).remove(own);
    }

    pub(super) fn forget_other(&self, other: &EndpointId) {
        lock(&self.known).retain(|(_, endpoint), _| endpoint != other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Qos;

    #[test]
    fn mismatch_names_both_types() {
        let mismatches = Mismatches::default();
        let types = ("sensor_msgs/msg/Image", "std_msgs/msg/String");
        mismatches.types([1; 16], [2; 16], "/camera/image_raw", types, true);
        let [text] = &mismatches.of(&[1; 16])[..] else {
            panic!("one is known")
        };
        for part in ["/camera/image_raw: a publisher", types.0, types.1] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn limit_of_mismatches_is_per_endpoint() {
        let mismatches = Mismatches::default();
        let types = ("std_msgs/msg/Bool", "std_msgs/msg/String");
        mismatches.types([1; 16], [2; 16], "/emergency_stop", types, true);
        for number in 0..2_000_u16 {
            let mut other = [3; 16];
            other[..2].copy_from_slice(&number.to_be_bytes());
            mismatches.types([4; 16], other, "/camera", types, true);
        }
        assert_eq!(mismatches.of(&[1; 16]).len(), 1);
        let known = lock(&mismatches.known).len();
        assert_eq!(known, 1 + LIMIT);
    }

    #[test]
    fn mismatch_is_listed_once_until_its_endpoints_leave() {
        let mismatches = Mismatches::default();
        let (wants, offers) = (
            qos::for_reader(Qos::latched(1)),
            qos::for_writer(Qos::reliable(10)),
        );
        let topic = || Some("/wm/plan".to_owned());
        for other in [2, 3, 3] {
            mismatches.policies([1; 16], [other; 16], topic(), true, (&wants, &offers));
        }
        let texts = mismatches.of(&[1; 16]);
        let [text] = &texts[..] else {
            panic!("{texts:?}")
        };
        assert!(
            text.starts_with(
                "/wm/plan: not connected to a publisher because of incompatible Durability"
            ),
            "{text}"
        );
        mismatches.forget_other(&[2; 16]);
        assert_eq!(mismatches.of(&[1; 16]).len(), 1);
        mismatches.forget_own(&[1; 16]);
        assert_eq!(mismatches.of(&[1; 16]), [""; 0]);

        let best_effort = qos::for_writer(Qos::best_effort(1));
        let reliable = qos::for_reader(Qos::reliable(1));
        mismatches.policies([1; 16], [2; 16], topic(), false, (&reliable, &best_effort));
        assert!(
            mismatches.of(&[1; 16])[0]
                .contains("a subscription because of incompatible Reliability")
        );
        mismatches.policies([1; 16], [4; 16], topic(), false, (&best_effort, &reliable));
        assert_eq!(mismatches.of(&[1; 16]).len(), 1, "these two do match");
    }

    #[test]
    fn reader_with_siblings_has_no_reliability_mismatch() {
        let mismatches = Mismatches::default();
        let (wants, offers) = (
            qos::for_reader(Qos::reliable(1)),
            qos::for_writer(Qos::best_effort(1)),
        );
        let own = [1; 16];
        mismatches.policies(own, [2; 16], None, true, (&wants, &offers));
        assert_eq!(mismatches.of(&own).len(), 1);
        mismatches.tolerate(own);
        mismatches.policies(own, [3; 16], None, true, (&wants, &offers));
        assert_eq!(mismatches.of(&own), [""; 0]);
        mismatches.types(own, [4; 16], "/stop", ("a/msg/A", "b/msg/B"), true);
        assert_eq!(mismatches.of(&own).len(), 1);
        mismatches.forget_own(&own);
        mismatches.policies(own, [2; 16], None, true, (&wants, &offers));
        assert_eq!(mismatches.of(&own).len(), 1);
    }
}
